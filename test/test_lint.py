# SPDX-License-Identifier: Apache-2.0
"""Check style and types of all code, as ``make lint`` does."""

from __future__ import annotations

import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ('gsdf_registration', 'msg_adapters', 'test', 'launch', 'benchmarks', 'docs', 'examples')


def installed(tool: str) -> str:
    """Return the tool with its version, as in setup.py; empty if it is not installed."""
    try:
        return f'{tool}=={importlib.metadata.version(tool)}'
    except importlib.metadata.PackageNotFoundError:
        return ''


@pytest.mark.parametrize('command', [['ruff', 'check'], ['mypy']], ids=['ruff', 'mypy'])
def test_lint(command: list[str]) -> None:
    needed = re.findall(rf"'({command[0]}==[\d.]+)'", (ROOT / 'setup.py').read_text())
    if installed(command[0]) not in needed:
        pytest.skip(f'needs {needed[0]}; {installed(command[0]) or "none"} is installed')
    done = subprocess.run([sys.executable, '-m', *command],
                          cwd=ROOT,
                          capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_source_file_has_a_licence_header() -> None:
    files = [file for folder in FOLDERS for file in (ROOT / folder).rglob('*.py')]
    assert len(files) > 20
    assert [str(file.relative_to(ROOT)) for file in files
            if 'SPDX-License-Identifier: Apache-2.0' not in file.read_text()] == []
