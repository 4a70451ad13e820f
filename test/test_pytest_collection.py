# SPDX-License-Identifier: Apache-2.0
"""pytest collects all tests, as ``colcon test`` runs it and whatever packages are missing."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

TEST = Path(__file__).parent
MODULES = sorted(TEST.rglob('test_*.py'))


def run_pytest(*arguments: str, without: str = '') -> str:
    """
    Run pytest in a process in which packages cannot be imported; return its output.

    It does not get the options of colcon: workers of ``-n`` could import the packages.
    """
    code = (f'import sys; sys.modules.update(dict.fromkeys({without.split()!r}))\n'
            f'import pytest; sys.exit(pytest.main({list(arguments)!r}))')
    paths = os.pathsep.join([str(TEST), os.environ.get('PYTHONPATH', '')])
    done = subprocess.run([sys.executable, '-c', code], cwd=TEST.parent, text=True,
                          env={**os.environ, 'PYTHONPATH': paths, 'PYTEST_ADDOPTS': ''},
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=100.0)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_plugin_of_launch_testing_collects_all_tests() -> None:
    lines = run_pytest('-p', 'launch_testing_hook', '--collect-only', '-q').splitlines()
    collected = [line for line in lines if '::' in line]
    assert len(collected) > 1000
    assert {TEST.parent / line.partition('::')[0] for line in collected} == set(MODULES)


def test_modules_that_need_a_missing_package_are_skipped_with_the_reason(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PYTEST_ADDOPTS', '--collect-only')      # as colcon sets it
    missing = ('matplotlib', 'rclpy')
    output = run_pytest('-p', 'launch_testing_hook', 'test/visualization/test_picture.py',
                        'test/clients/test_processes.py', 'test/ros', without=' '.join(missing))
    for package in missing:
        assert f'{package} is not installed' in output
    assert ' passed' in output and ' error' not in output


@pytest.mark.parametrize('file', MODULES, ids=lambda file: file.stem)
def test_no_module_skips_itself_while_it_is_imported(file: Path) -> None:
    statements = [each for each in ast.parse(file.read_text()).body
                  if not isinstance(each, (ast.FunctionDef, ast.ClassDef))]
    names = {ast.unparse(node.func) for each in statements for node in ast.walk(each)
             if isinstance(node, ast.Call)}
    assert not names & {'pytest.importorskip', 'pytest.skip', 'pytest.exit'}
