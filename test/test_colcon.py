# SPDX-License-Identifier: Apache-2.0
"""Test that colcon builds and tests the package in a ROS workspace."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

# of the ROS install, or of the wheels
PREFIXES = os.environ.get('AMENT_PREFIX_PATH', sys.prefix)
COLCON = [sys.executable, '-m', 'colcon', '--log-base', 'log']


class Workspace(NamedTuple):
    """A workspace in which the package is built and installed."""

    folder: Path
    source: Path
    symlinks: bool      # installed with --symlink-install

    @property
    def prefix(self) -> Path:
        return self.folder / 'install/gsdf_registration'

    @property
    def share(self) -> Path:
        return self.prefix / 'share/gsdf_registration'

    def run(self, *command: str) -> str:
        """Run a command in the workspace and return its output."""
        paths = os.pathsep.join([str(self.source / 'test'), os.environ.get('PYTHONPATH', '')])
        done = subprocess.run(command, cwd=self.folder, text=True, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT,
                              env={**os.environ, 'AMENT_PREFIX_PATH': PREFIXES,
                                   'PYTHONPATH': paths})
        assert done.returncode == 0, done.stdout
        return done.stdout

    def colcon(self, verb: str, *options: str) -> str:
        """Run colcon in the workspace and return its output."""
        places = [] if verb == 'test-result' else ['--base-paths', str(self.source)]
        return self.run(*COLCON, verb, *places, *options)

    def sourced(self, code: str) -> str:
        """Return what Python prints in a shell that has sourced the workspace."""
        return self.run('bash', '-c', f'. install/setup.bash && "{sys.executable}" -c "{code}"')


@pytest.fixture(scope='module', params=[False, True], ids=['copies', 'symlinks'])
def workspace(request: pytest.FixtureRequest, source_copy: Path,
              tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """Return a workspace, one with copies and one with --symlink-install."""
    if importlib.util.find_spec('colcon_ros') is None:
        pytest.skip('colcon is not installed')
    built = Workspace(tmp_path_factory.mktemp('built'), source_copy, request.param)
    built.colcon('build', *['--symlink-install'] * request.param)
    return built


def test_executables_are_where_ros2_run_finds_them(workspace: Workspace) -> None:
    folder = workspace.prefix / 'lib/gsdf_registration'
    assert {file.name for file in folder.iterdir()} == {
        'gsdf', 'registration_console', 'registration_node'}
    assert all(os.access(file, os.X_OK) for file in folder.iterdir())


def test_share_directory_is_in_the_ament_index(workspace: Workspace) -> None:
    printed = workspace.sourced('from ament_index_python.packages import '
                                'get_package_share_directory as share; '
                                "print(share('gsdf_registration'))")
    assert Path(printed.split()[-1]) == workspace.share
    for file in ('config/registration.yaml', 'examples/operator_client.py', 'bags/hip.ply',
                 'launch/registration.launch.py'):
        assert (workspace.share / file).is_file()
        assert ((workspace.share / file).resolve() == workspace.source / file) is workspace.symlinks


def test_installed_packages_can_be_imported(workspace: Workspace) -> None:
    printed = workspace.sourced('import gsdf_registration, msg_adapters; '
                                'print(gsdf_registration.__file__, msg_adapters.__file__)')
    place = workspace.folder / 'build/gsdf_registration' if workspace.symlinks else workspace.prefix
    assert printed.count(f'{place}/') == 2


def test_example_package_is_found_only_in_its_folder(workspace: Workspace) -> None:
    found = workspace.run(*COLCON, 'list', '--names-only', '--base-paths', str(workspace.source))
    assert found.split() == ['gsdf_registration']
    found = workspace.run(*COLCON, 'list', '--names-only', '--base-paths',
                          str(workspace.source / 'examples/cpp'))
    assert found.split() == ['gsdf_registration_example']


def test_colcon_test_runs_pytest_with_the_plugin_of_launch_testing(workspace: Workspace) -> None:
    workspace.colcon('test', '--pytest-args', '-p', 'launch_testing_hook',
                     'test/mesh/test_repair.py', 'test/clients/test_processes.py')
    found = re.search(r'(\d+) tests, 0 errors, 0 failures',
                      workspace.colcon('test-result', '--all'))
    assert found is not None and int(found[1]) > 10
