# SPDX-License-Identifier: Apache-2.0
"""How the kernels of the build are compiled: once for all runs, free of the interpreter lock."""

from __future__ import annotations

import numba as nb

# error_model: divisions that need not raise let arrays pass uncounted, a fifth of the time
compiled = nb.njit(nogil=True, cache=True, error_model='numpy')
inlined = nb.njit(nogil=True, cache=True, error_model='numpy', forceinline=True)
vectorized = nb.njit(nogil=True, cache=True, error_model='numpy', fastmath=True)
