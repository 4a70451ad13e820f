# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks``: one module per benchmark, help, and errors in one line."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import benchmarks
from benchmarks.__main__ import BENCHMARKS, main

ROOT = Path(benchmarks.__file__).parent


def test_every_command_module_is_a_benchmark() -> None:
    modules = {file.stem for file in (ROOT / 'commands').glob('*.py')} - {'__init__'}
    assert modules == set(BENCHMARKS)


def test_runs_as_a_module_in_a_checkout() -> None:
    done = subprocess.run([sys.executable, '-m', 'benchmarks', '--help'], cwd=ROOT.parent,
                          capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith('usage: python -m benchmarks')


@pytest.mark.parametrize(('words', 'message'), [
    (['feild'], 'benchmarks: error: "feild" is not a command; did you mean field?'),
    (['trust', '--trails', '3'], 'unknown option --trails; did you mean --trials?'),
])
def test_suggests_the_nearest_word(capsys: pytest.CaptureFixture[str], words: list[str],
                                   message: str) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    error = capsys.readouterr().err
    assert end.value.code == 2 and message in error and error.count('\n') == 1


def test_no_benchmark_imports_the_command_line_or_the_node() -> None:
    for file in ROOT.rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                assert node.module.split('.')[:2] not in (['gsdf_registration', 'cli'],
                                                          ['gsdf_registration', 'node']), file
