# SPDX-License-Identifier: Apache-2.0
"""The memory of the compiler is returned, and the compiler still works."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numba
import pytest

from gsdf_registration.node.memory import COMPILER, release_compiler


def compiler_pages() -> int:
    """Return how much of the compiler is in memory, kB."""
    mappings = re.split(r'\n(?=[0-9a-f]+-[0-9a-f]+ )', Path('/proc/self/smaps').read_text())
    return sum(int(size) for mapping in mappings if COMPILER in mapping
               for size in re.findall(r'\nRss: +(\d+) kB', mapping))


@pytest.mark.skipif(sys.platform != 'linux', reason='only Linux says what is in memory')
def test_returns_the_compiler_which_still_works() -> None:
    before = compiler_pages()
    release_compiler()
    assert compiler_pages() < 0.2 * before
    assert numba.njit(lambda x: x + 1)(2) == 3
    assert compiler_pages() > 0.2 * before


def test_does_nothing_on_another_system(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object, **__: object) -> str:
        raise FileNotFoundError
    monkeypatch.setattr(Path, 'read_text', missing)
    release_compiler()
