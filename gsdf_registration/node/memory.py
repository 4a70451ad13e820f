# SPDX-License-Identifier: Apache-2.0
"""Limit the memory that the C library keeps for later instead of returning it to the system."""

from __future__ import annotations

import ctypes

# of mallopt(3); sizes in bytes
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
LARGE = 1 << 20     # arrays of this size are returned as soon as they are freed
KEPT = 4 << 20      # free memory kept at the end of the heap
ARENAS = 2          # separate heaps for threads; the compiled code does not allocate in its loops


def limit_memory() -> None:
    """Set the limits; without effect unless the C library is glibc."""
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt is None:
        return
    for option, value in ((M_MMAP_THRESHOLD, LARGE), (M_TRIM_THRESHOLD, KEPT),
                          (M_ARENA_MAX, ARENAS)):
        mallopt(option, value)
