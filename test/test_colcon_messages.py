# SPDX-License-Identifier: Apache-2.0
"""Both packages build in one ROS workspace, with the base paths that the README gives."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COLCON = [sys.executable, '-m', 'colcon', '--log-base', 'log']
BASE_PATHS = ['--base-paths', 'src/gsdf_registration',
              'src/gsdf_registration/gsdf_registration_msgs']
PREFIXES = os.environ.get('AMENT_PREFIX_PATH', sys.prefix)
# the generators compile C++; on loaded machines this takes minutes
pytestmark = pytest.mark.timeout(600)


def missing() -> str:
    """Return what is missing on this machine to build messages; empty if nothing."""
    if not any(Path(prefix, 'share/rosidl_default_generators').is_dir()
               for prefix in PREFIXES.split(os.pathsep)):
        return 'rosidl_default_generators is not installed'
    try:
        import colcon_ros  # noqa: F401

        from msg_adapters import results
    except ImportError as error:
        return str(error)
    # the CMake files of the wheels work only after this script has patched them
    return '' if results.available() else 'run tools/build_messages.py first'


def run(workspace: Path, *command: str) -> str:
    """Run a command in the workspace, without the paths of other workspaces; return its output."""
    environment = {**os.environ, 'AMENT_PREFIX_PATH': PREFIXES,
                   'PATH': f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}'}
    done = subprocess.run(command, cwd=workspace, env=environment, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture(scope='module')
def workspace(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a workspace in which both packages are built."""
    reason = missing()
    if reason:
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp('both')
    shutil.copytree(source_copy, folder / 'src/gsdf_registration')
    run(folder, *COLCON, 'build', *BASE_PATHS)
    return folder


def test_readme_gives_the_base_paths() -> None:
    assert ' '.join(['colcon build', *BASE_PATHS]) in (ROOT / 'README.md').read_text()


def test_colcon_finds_both_packages(workspace: Path) -> None:
    names = run(workspace, *COLCON, 'list', '--names-only', *BASE_PATHS).split()
    assert sorted(names) == ['gsdf_registration', 'gsdf_registration_msgs']


def test_python_imports_both_packages_from_the_workspace(workspace: Path) -> None:
    code = ('import gsdf_registration, gsdf_registration_msgs; from msg_adapters import results; '
            'print(gsdf_registration.__file__, gsdf_registration_msgs.__file__, '
            'results.available())')
    printed = run(workspace, 'bash', '-c',
                  f'. install/setup.bash && cd install && "{sys.executable}" -c "{code}"')
    install = workspace / 'install'
    for name in ('gsdf_registration', 'gsdf_registration_msgs'):
        assert f'{install / name}/' in printed
    assert printed.rstrip().endswith('True')


def test_cpp_headers_are_installed(workspace: Path) -> None:
    include = workspace / 'install/gsdf_registration_msgs/include'
    assert list(include.rglob('msg/registration_result.hpp'))
    assert list(include.rglob('srv/register.hpp'))
