# SPDX-License-Identifier: Apache-2.0
"""Test that the algorithms and the command line do not need ROS."""

from __future__ import annotations

import pkgutil
import subprocess
import sys

import pytest

import gsdf_registration
import msg_adapters

# Hides an installed ROS from the process
WITHOUT_ROS = """
import importlib, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        package = name.split('.')[0]
        if package.startswith('rcl') or package.endswith(('_msgs', '_srvs', '_interfaces')):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, NoRos())
"""
# The modules that import ROS
WITH_ROS = ('gsdf_registration.node.', 'gsdf_registration.clients.',
            'msg_adapters.ros_lost_messages')
MODULES = {'gsdf_registration.registration.pipeline', 'gsdf_registration.session.replay',
           'gsdf_registration.live.worker', 'gsdf_registration.cli.main', 'msg_adapters.bag'}


def modules() -> list[str]:
    """Return the names of all modules of both packages that do not import ROS."""
    found = [module.name for package in (gsdf_registration, msg_adapters)
             for module in pkgutil.walk_packages(package.__path__, f'{package.__name__}.')]
    return [name for name in found if not name.startswith(WITH_ROS)]


def run(code: str) -> subprocess.CompletedProcess[str]:
    """Run Python code in a process without ROS."""
    return subprocess.run([sys.executable, '-c', WITHOUT_ROS + code],
                          capture_output=True,
                          text=True)


def test_the_import_hook_hides_ros() -> None:
    assert "No module named 'rclpy'" in run('import rclpy').stderr
    assert "No module named 'geometry_msgs'" in run('import geometry_msgs.msg').stderr


def test_modules_import_without_ros() -> None:
    names = modules()
    assert set(names) >= MODULES
    done = run(f'for name in {names!r}: importlib.import_module(name)')
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize('module', [
    'gsdf_registration.common.rigid', 'gsdf_registration.field', 'gsdf_registration.session',
    'gsdf_registration.registration.pipeline', 'gsdf_registration.live.worker'])
def test_algorithms_do_not_import_adapters(module: str) -> None:
    done = run(
        f'importlib.import_module({module!r}); print({{name.split(".")[0] for name in sys.modules}}'
        ' & {"msg_adapters", "rosbags", "trimesh", "mcap"})')
    assert done.stdout.strip() == 'set()', done.stdout + done.stderr
