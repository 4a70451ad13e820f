# SPDX-License-Identifier: Apache-2.0
"""Style and types of all the code: the same as ``make lint``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize('command', [['ruff', 'check'], ['mypy']], ids=['ruff', 'mypy'])
def test_lint(command: list[str]) -> None:
    done = subprocess.run([sys.executable, '-m', *command],
                          cwd=ROOT,
                          capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_source_file_names_its_licence() -> None:
    folders = ('gsdf_registration', 'msg_adapters', 'test', 'launch', 'benchmarks', 'docs',
               'examples', 'tools')
    files = [file for folder in folders for file in (ROOT / folder).rglob('*.py')]
    bare = [str(file.relative_to(ROOT)) for file in files
            if not file.read_text().startswith('# SPDX-License-Identifier: Apache-2.0\n')]
    assert len(files) > 20
    assert bare == []
