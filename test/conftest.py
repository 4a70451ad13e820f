# SPDX-License-Identifier: Apache-2.0
"""
Fixtures of several test modules: bones and recordings of bags/, and a copy of the sources.

Modules that need an optional package are not imported without it, see `NEEDS`.
"""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from msg_adapters.bag import read_bag
from msg_adapters.points import read_model
from msg_adapters.recording import Recording
from msg_adapters.truth import Truth, read_truth

ROOT = Path(__file__).parents[1]
SOURCES = ('package.xml', 'setup.py', 'setup.cfg', 'pyproject.toml', 'README.md', 'LICENSE',
           'resource', 'config', 'launch', 'bags', 'examples', 'gsdf_registration',
           'gsdf_registration_msgs', 'msg_adapters', 'test', 'benchmarks', 'docs', 'tools')
# The optional package that a module or the modules of a folder import.  No module skips itself
# while it is imported: with the pytest plugin of launch_testing that ends the collection.
NEEDS = {
    'cli/test_report_option.py': 'PIL', 'cli/test_result_schema.py': 'jsonschema',
    'cli/test_show.py': 'matplotlib',
    'msg_adapters/test_dicom_seg.py': 'highdicom',
    'msg_adapters/test_igtl.py': 'pyigtl',
    'msg_adapters/test_markers.py': 'visualization_msgs',
    'msg_adapters/test_ros.py': 'geometry_msgs',
    'msg_adapters/test_segmentation.py': 'SimpleITK',
    'msg_adapters/test_slicer_transform.py': 'SimpleITK',
    'msg_adapters/test_vtk_mesh.py': 'vtk', 'node': 'rclpy', 'ros': 'rclpy',
    'ros/test_console_in_browser.py': 'playwright', 'ros/test_igtl_bridge.py': 'pyigtl',
    'cli/test_view.py': 'viser', 'visualization/test_console_page.py': 'playwright',
    'visualization/test_timeline.py': 'viser',
    'visualization/test_picture.py': 'matplotlib', 'visualization/test_report.py': 'PIL'}

# They take longest, so they start first: else one of them runs on at the end, while other
# workers have nothing left to do.
LONGEST = ('ros/test_console_in_browser.py', 'test_colcon_messages.py', 'ros/test_pose_lifetime.py',
           'ros/test_signals.py', 'ros/test_parameters.py', 'test_colcon.py',
           'visualization/test_console_page.py', 'ros/test_recorded_operation.py',
           'tracking/test_pivot.py', 'test_lint.py', 'benchmarks/test_trust.py')


class SkippedModule(pytest.File):
    """A test module that is not imported, because a package is not installed."""

    package = ''

    def collect(self) -> Iterator[SkippedTests]:
        yield SkippedTests.from_parent(self, name=f'needs {self.package}')


class SkippedTests(pytest.Item):
    """Stands for all tests of the module."""

    parent: SkippedModule

    def runtest(self) -> None:
        pytest.skip(f'{self.parent.package} is not installed')


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.File | None:
    """Replace a module that needs a package which is not installed."""
    name = module_path.relative_to(Path(__file__).parent).as_posix()
    for package in filter(None, (NEEDS.get(name), NEEDS.get(name.partition('/')[0]))):
        if importlib.util.find_spec(package) is None:
            skipped: SkippedModule = SkippedModule.from_parent(parent, path=module_path)
            skipped.package = package
            return skipped
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the modules that take longest."""
    first = [Path(__file__).parent / name for name in LONGEST]
    items.sort(key=lambda item: first.index(item.path) if item.path in first else len(first))


@pytest.fixture(scope='session')
def source_copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the sources in which the package can be built."""
    copy = tmp_path_factory.mktemp('workspace') / 'gsdf_registration'
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns('__pycache__'))
        else:
            copy.mkdir(exist_ok=True)
            shutil.copy(ROOT / name, copy / name)
    return copy


@pytest.fixture(scope='session')
def bags() -> Path:
    """Return the directory of the bones and recordings."""
    return ROOT / 'bags'


@pytest.fixture(scope='session')
def hip_bone(bags: Path) -> Path:
    return bags / 'hip.ply'


@pytest.fixture(scope='session')
def femur_bone(bags: Path) -> Path:
    return bags / 'femur.ply'


@pytest.fixture(scope='session')
def hip_surface(hip_bone: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (n, 3), m, and faces (m, 3) of the hip."""
    vertices, faces, _ = read_model(hip_bone, 'mm')
    assert faces is not None
    return vertices, faces


@pytest.fixture(scope='session')
def femur_surface(femur_bone: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (n, 3), m, and faces (m, 3) of the femur."""
    vertices, faces, _ = read_model(femur_bone, 'mm')
    assert faces is not None
    return vertices, faces


@pytest.fixture(scope='session')
def optical_bag(bags: Path) -> Path:
    return bags / 'hip_optical'


@pytest.fixture(scope='session')
def em_bag(bags: Path) -> Path:
    return bags / 'femur_em'


@pytest.fixture(scope='session')
def optical_recording(optical_bag: Path) -> tuple[Recording, Truth]:
    return read_bag(optical_bag), read_truth(optical_bag.with_suffix('.yaml'))


@pytest.fixture(scope='session')
def em_recording(em_bag: Path) -> tuple[Recording, Truth]:
    return read_bag(em_bag), read_truth(em_bag.with_suffix('.yaml'))
