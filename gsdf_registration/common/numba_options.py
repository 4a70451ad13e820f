# SPDX-License-Identifier: Apache-2.0
"""
How kernels are compiled: cached on disk, without the interpreter lock.

Each decorator adds one permission.  Division by zero yields inf or NaN as in numpy; without that
check, arrays pass uncounted, which saves a fifth of the time.
"""

from __future__ import annotations

from typing import Any

import numba as nb

_options: dict[str, Any] = {'nogil': True, 'cache': True, 'error_model': 'numpy'}

# IEEE arithmetic, as written
compiled = nb.njit(**_options)
inlined = nb.njit(forceinline=True, **_options)
# products may be fused with sums (FMA), which loses no precision; the order stays as written
kernel = nb.njit(fastmath={'contract'}, **_options)
inlined_kernel = nb.njit(fastmath={'contract'}, forceinline=True, **_options)
# sums may be reordered, so that loops vectorize; the order is the same in every run
reordered = nb.njit(fastmath={'contract', 'reassoc', 'nsz', 'nnan', 'ninf', 'arcp'},
                    forceinline=True, **_options)
# all of that, on values known to be finite
vectorized = nb.njit(fastmath=True, **_options)
