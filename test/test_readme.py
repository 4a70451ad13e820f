# SPDX-License-Identifier: Apache-2.0
"""What the documents say is true."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / 'README.md').read_text()
DOCUMENTS = ('README.md', 'CONTRIBUTING.md', 'CHANGELOG.md')


@pytest.mark.parametrize('document', DOCUMENTS)
def test_links_lead_to_files(document: str) -> None:
    links = re.findall(r'\]\((?!http)([^)#]+)', (ROOT / document).read_text())
    assert links or document == 'CHANGELOG.md'
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_the_python_example_finds_the_bone(tmp_path: Path) -> None:
    example, = re.findall(r'```python\n(.*?)```', README, re.DOTALL)
    done = subprocess.run([sys.executable, '-c', example + 'assert result.success\n'],
                          cwd=ROOT,
                          env={**os.environ, 'GSDF_CACHE_DIR': str(tmp_path)},
                          capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize('command', sorted(set(re.findall(r'`gsdf ([\w-]+)', README))))
def test_commands_that_are_named_exist(command: str) -> None:
    done = subprocess.run([sys.executable, '-m', 'gsdf_registration.cli.main', command, '--help'],
                          cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 'example' in done.stdout


def test_targets_that_are_named_exist() -> None:
    targets = set(re.findall(r'make (\w+)', README)) & {'demo', 'test', 'lint', 'bench'}
    assert {'demo', 'test'} <= targets
    for target in targets:
        assert re.search(rf'^{target}:', (ROOT / 'Makefile').read_text(), re.MULTILINE)
