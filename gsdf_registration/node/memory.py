# SPDX-License-Identifier: Apache-2.0
"""Return memory to the system that the C library or the compiler of the kernels keeps."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

# of mallopt(3); sizes in bytes
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
LARGE = 1 << 20     # arrays of this size are returned as soon as they are freed
KEPT = 4 << 20      # free memory kept at the end of the heap
ARENAS = 2          # separate heaps for threads; the compiled code does not allocate in its loops

MADV_DONTNEED = 4   # of madvise(2)
COMPILER = 'libllvmlite.so'
_MAPPING = re.compile(r'([0-9a-f]+)-([0-9a-f]+) \S+ \S+ \S+ \d+ +(.*)')


def limit_memory() -> None:
    """Set the limits; without effect unless the C library is glibc."""
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt is None:
        return
    for option, value in ((M_MMAP_THRESHOLD, LARGE), (M_TRIM_THRESHOLD, KEPT),
                          (M_ARENA_MAX, ARENAS)):
        mallopt(option, value)


def release_compiler() -> None:
    """
    Return the pages of the compiler, 100 MB, once the kernels are loaded.

    They are read from its file again if they are needed.  Without effect unless the system is
    Linux.
    """
    try:
        entries = Path('/proc/self/smaps').read_text().splitlines()
    except OSError:
        return
    begin = end = 0
    for entry in entries:
        mapping = _MAPPING.fullmatch(entry)
        if mapping is not None:
            ours = mapping[3].endswith(COMPILER)
            begin, end = (int(mapping[1], 16), int(mapping[2], 16)) if ours else (0, 0)
        elif begin and entry.split() == ['Anonymous:', '0', 'kB']:  # nothing in it was changed
            ctypes.CDLL(None).madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin),
                                      MADV_DONTNEED)
