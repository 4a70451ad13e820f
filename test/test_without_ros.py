# SPDX-License-Identifier: Apache-2.0
"""The algorithms and the command line run on a machine without ROS."""

from __future__ import annotations

import pkgutil
import subprocess
import sys

import pytest

import gsdf_registration
import msg_adapters

# A process in which ROS is not installed: the finder refuses what a ROS install brings.
WITHOUT_ROS = """
import importlib, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        package = name.split('.')[0]
        if package.startswith('rcl') or package.endswith(('_msgs', '_srvs', '_interfaces')):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, NoRos())
"""
# The only rooms that know ROS.
WITH_ROS = ('gsdf_registration.node', 'msg_adapters.results', 'msg_adapters.ros')
# Scripts that run in the environments of other libraries.
ELSEWHERE = ('benchmarks.peers.workers.',)


def modules() -> list[str]:
    """Return the names of all modules of both packages but those that need ROS."""
    found = [module.name for package in (gsdf_registration, msg_adapters)
             for module in pkgutil.walk_packages(package.__path__, f'{package.__name__}.')]
    return [name for name in found if not name.startswith(WITH_ROS + ELSEWHERE)]


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, '-c', WITHOUT_ROS + code],
                          capture_output=True,
                          text=True)


def test_the_hook_hides_ros() -> None:
    assert "No module named 'rclpy'" in run('import rclpy').stderr
    assert "No module named 'geometry_msgs'" in run('import geometry_msgs.msg').stderr


def test_every_module_but_the_node_imports_without_ros() -> None:
    names = modules()
    assert {
        'gsdf_registration.registration.pipeline', 'gsdf_registration.session', 'gsdf_registration.session.replay',
        'gsdf_registration.cli.main', 'msg_adapters.bag'
    } <= set(names)
    done = run(f'for name in {names!r}: importlib.import_module(name)')
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize('room', ['gsdf_registration.common.rigid', 'gsdf_registration.registration.pipeline',
                                  'gsdf_registration.session', 'gsdf_registration.field'])
def test_the_algorithms_know_no_files_and_no_messages(room: str) -> None:
    done = run(
        f'importlib.import_module({room!r}); print({{name.split(".")[0] for name in sys.modules}} '
        '& {"msg_adapters", "rosbags", "trimesh", "mcap"})')
    assert done.stdout.strip() == 'set()', done.stdout + done.stderr
