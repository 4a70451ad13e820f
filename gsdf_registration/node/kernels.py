# SPDX-License-Identifier: Apache-2.0
"""
Compiles the kernels in a process of its own, once on a machine; then they come from the cache.

The compiler holds the interpreter lock for up to half a second at a time, and for a minute in all.
In the process of the node it would delay every service.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

from gsdf_registration.node.warm_up import compile_kernels

Log = Callable[[str], None]


class _NotCached(Exception):
    """A kernel is not in the cache."""


class _Refuse(event.Listener):
    """Refuses to compile in one thread."""

    def __init__(self) -> None:
        self._thread = threading.get_ident()

    def on_start(self, event: Any) -> None:
        if threading.get_ident() == self._thread:
            raise _NotCached

    def on_end(self, event: Any) -> None:
        pass


def load_kernels(show: Callable[[str], None], warn: Callable[[str], None]) -> None:
    """
    Load all kernels into this process; compile them before, in another one, if they are not cached.

    ``show`` receives a sentence on the progress, ``warn`` one on a cache that cannot be written.
    """
    try:
        with _no_compilation():
            compile_kernels()
    except _NotCached:
        _compile_apart(show, warn)
        compile_kernels()


@contextmanager
def _no_compilation() -> Iterator[None]:
    with event.install_listener('numba:compile', _Refuse()):
        yield


def _compile_apart(show: Callable[[str], None], warn: Callable[[str], None]) -> None:
    """Compile in another process, which ends with this one."""
    process = subprocess.Popen([sys.executable, '-m', __name__], stdin=subprocess.PIPE,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               start_new_session=True)
    show('compiling, once on this machine; wait a moment')
    assert process.stdout is not None
    for line in process.stdout:
        show(f'compiling, once on this machine ({line.strip()} %); wait a moment')
    _, errors = process.communicate()
    if process.returncode != 0:
        last = errors.strip().splitlines()[-1:] or [f'exit status {process.returncode}']
        warn(f'the kernels cannot be compiled ahead, and services may be slow meanwhile: {last[0]}')


def main() -> None:
    """Compile the kernels, print the progress in percent, and end with the parent process."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    compile_kernels(lambda share: print(round(100.0 * share), flush=True))


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == '__main__':
    main()
