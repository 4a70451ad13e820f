# SPDX-License-Identifier: Apache-2.0
"""Test that colcon builds and tests the package in a ROS workspace."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

COLCON = [sys.executable, '-m', 'colcon', '--log-base', 'log']


def colcon(workspace: Path, *arguments: str) -> str:
    """Run colcon in the workspace and return its output."""
    done = subprocess.run([*COLCON, *arguments],
                          cwd=workspace,
                          text=True,
                          stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT,
                          env={**os.environ, 'AMENT_PREFIX_PATH': sys.prefix})
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture(scope='module')
def workspace(source_copy: Path) -> Path:
    """Return a workspace in which the package is built and installed."""
    pytest.importorskip('colcon_ros')
    colcon(source_copy.parent, 'build')
    return source_copy.parent


def test_executables_are_where_ros2_run_finds_them(workspace: Path) -> None:
    folder = workspace / 'install/gsdf_registration/lib/gsdf_registration'
    assert {file.name for file in folder.iterdir()} == {'gsdf', 'registration_node'}
    assert all(os.access(file, os.X_OK) for file in folder.iterdir())


def test_share_directory_is_in_the_ament_index(workspace: Path) -> None:
    prefix = workspace / 'install/gsdf_registration'
    code = ("from ament_index_python.packages import get_package_share_directory as share; "
            "print(share('gsdf_registration'))")
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True,
                          env={**os.environ, 'AMENT_PREFIX_PATH': str(prefix)})
    assert Path(done.stdout.strip()) == prefix / 'share/gsdf_registration'
    assert (prefix / 'share/gsdf_registration/launch/registration.launch.py').is_file()
    assert (prefix / 'share/gsdf_registration/config/registration.yaml').is_file()


def test_installed_packages_can_be_imported(workspace: Path, tmp_path: Path) -> None:
    site = next((workspace / 'install/gsdf_registration/lib').glob('python3*/site-packages'))
    code = ('import gsdf_registration, msg_adapters; '
            'print(gsdf_registration.__file__, msg_adapters.__file__)')
    done = subprocess.run([sys.executable, '-c', code],
                          cwd=tmp_path,
                          capture_output=True,
                          text=True,
                          check=True,
                          env={**os.environ, 'PYTHONPATH': str(site)})
    assert done.stdout.count(str(site)) == 2


def test_colcon_test_runs_pytest(workspace: Path) -> None:
    colcon(workspace, 'test', '--pytest-args', 'test/common/test_rigid.py')
    assert ' 0 errors, 0 failures' in colcon(workspace, 'test-result', '--all')
