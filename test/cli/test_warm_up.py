# SPDX-License-Identifier: Apache-2.0
"""``gsdf warm-up`` compiles the kernels, and other commands do before they measure time."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import pytest

from gsdf_registration.cli.main import main
from gsdf_registration.common.command_line import progress_bar

COMPILED = 'gsdf_registration.common.kernel_cache.kernels_compiled'
COMPILE = 'gsdf_registration.registration.kernels.compile_kernels'


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Let the cache be empty, and record each compilation instead of compiling."""
    found: list[bool] = []

    def compile_kernels(progress: Callable[[float], None]) -> None:
        progress(0.5)
        found.append(True)
    monkeypatch.setattr(COMPILED, lambda: bool(found))
    monkeypatch.setattr(COMPILE, compile_kernels)
    return found


def test_compiles_once(calls: list[bool], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['warm-up']) == 0
    assert capsys.readouterr().out.startswith('all kernels are compiled now (')
    assert main(['warm-up']) == 0
    out, err = capsys.readouterr()
    assert (out, err) == ('all kernels are compiled already\n', '')
    assert len(calls) == 1


@pytest.mark.parametrize('command', [['register', '{model}', '{points}', '--unit', 'mm'],
                                     ['replay', '{points}', '--model', '{model}']])
def test_other_commands_compile_first(command: list[str], calls: list[bool], hip_bone: Path,
                                      tmp_path: Path) -> None:
    words = [word.format(model=hip_bone, points=tmp_path / 'none.csv') for word in command]
    assert main(words) == 2     # there is no such recording
    assert len(calls) == 1


def test_an_error_of_the_model_comes_before_the_compilation(
        calls: list[bool], tmp_path: Path) -> None:
    assert main(['register', str(tmp_path / 'none.stl'), 'points.csv', '--unit', 'mm']) == 2
    assert not calls


def test_shows_progress_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream, shown in (Terminal(), True), (io.StringIO(), False):
        monkeypatch.setattr('sys.stderr', stream)
        with progress_bar('compiling') as show:
            show(0.5)
        assert ('\rcompiling [' in stream.getvalue() and ' 50 %' in stream.getvalue()) == shown
        assert bool(stream.getvalue()) == shown
