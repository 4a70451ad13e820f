# SPDX-License-Identifier: Apache-2.0
"""
The numba decorators of all kernels.

All kernels are cached on disk and release the GIL. Each decorator allows the compiler one thing
more than the one before. Division by zero yields inf or NaN as in NumPy: without the check for it
numba need not count references to arrays, which saves a fifth of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# imported before numba, which reads NUMBA_CACHE_DIR
from gsdf_registration.common.kernel_cache import cache_folder  # isort: skip

import numba as nb
from numba.core import event

_options: dict[str, Any] = {'nogil': True, 'cache': cache_folder() is not None,
                            'error_model': 'numpy'}

# IEEE arithmetic in the order of the source
compiled = nb.njit(**_options)
inlined = nb.njit(forceinline=True, **_options)
# a product and a sum may be fused (FMA); the order of operations stays that of the source
kernel = nb.njit(fastmath={'contract'}, **_options)
inlined_kernel = nb.njit(fastmath={'contract'}, forceinline=True, **_options)
# sums may be reordered so that loops vectorize; the order is the same in every call
reordered = nb.njit(fastmath={'contract', 'reassoc', 'nsz', 'nnan', 'ninf', 'arcp'},
                    forceinline=True, **_options)
# all optimizations, for values that are known to be finite
vectorized = nb.njit(fastmath=True, **_options)


class _Listener(event.Listener):
    def __init__(self, call: Callable[[], None]) -> None:
        self._call = call

    def on_start(self, event: event.Event) -> None:
        pass

    def on_end(self, event: event.Event) -> None:
        self._call()


@contextmanager
def on_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call ``call`` after each function that numba compiles or loads from its cache."""
    with event.install_listener('numba:compile', _Listener(call)):
        yield
