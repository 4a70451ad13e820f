# SPDX-License-Identifier: Apache-2.0
"""Test what ``pip install`` installs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

import gsdf_registration

ROOT = Path(__file__).parents[1]
MANIFEST = ElementTree.parse(ROOT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def installed(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a prefix with the package installed by pip, without its dependencies."""
    prefix = tmp_path_factory.mktemp('prefix')
    # --ignore-installed: otherwise pip would uninstall the package from this environment
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps',
                    '--no-build-isolation', '--ignore-installed', '--prefix', str(prefix),
                    str(source_copy)], check=True)
    return prefix


def site_packages(prefix: Path) -> Path:
    """Return the site-packages directory of a prefix."""
    return next(prefix.glob('lib/python3*/site-packages'))


@pytest.mark.parametrize('script', ['gsdf', 'registration_node'])
def test_installs_console_scripts(installed: Path, script: str) -> None:
    assert os.access(installed / 'bin' / script, os.X_OK)


def test_installed_command_runs(installed: Path, tmp_path: Path) -> None:
    done = subprocess.run([installed / 'bin/gsdf', '--help'],
                          cwd=tmp_path,
                          capture_output=True,
                          text=True,
                          env={**os.environ, 'PYTHONPATH': str(site_packages(installed))})
    assert done.returncode == 0, done.stderr
    assert 'register' in done.stdout


def test_installs_every_module(installed: Path) -> None:
    for package in ('gsdf_registration', 'msg_adapters'):
        sources = {file.relative_to(ROOT) for file in (ROOT / package).rglob('*.py')}
        found = {file.relative_to(site_packages(installed))
                 for file in (site_packages(installed) / package).rglob('*.py')}
        assert found == sources


def test_does_not_install_benchmarks_and_tests(installed: Path) -> None:
    packages = {path.name for path in site_packages(installed).iterdir() if path.is_dir()}
    assert {name for name in packages if not name.endswith('.dist-info')} == {
        'gsdf_registration', 'msg_adapters'}


def test_installs_the_share_directory(installed: Path) -> None:
    assert (installed / 'share/ament_index/resource_index/packages/gsdf_registration').is_file()
    share = installed / 'share/gsdf_registration'
    assert (share / 'package.xml').is_file()
    assert (share / 'launch/registration.launch.py').is_file()
    for folder in ('config', 'bags'):
        sources = {file.relative_to(ROOT) for file in (ROOT / folder).rglob('*') if file.is_file()}
        assert {file.relative_to(share)
                for file in (share / folder).rglob('*') if file.is_file()} == sources
        assert sources


def test_version_is_the_same_everywhere(installed: Path) -> None:
    version = gsdf_registration.__version__
    assert MANIFEST.findtext('version') == version
    assert (site_packages(installed) / f'gsdf_registration-{version}.dist-info').is_dir()
    assert f'## [{version}]' in (ROOT / 'CHANGELOG.md').read_text()


def test_manifest_declares_every_imported_ros_package() -> None:
    declared = {element.text for element in MANIFEST if element.tag in ('depend', 'exec_depend')}
    sources = [file.read_text() for package in ('gsdf_registration', 'msg_adapters', 'launch')
               for file in (ROOT / package).rglob('*.py')]
    names = re.compile(
        r'(?m)^\s*(?:from|import) (\w+(?:_msgs|_srvs|_interfaces)|rclpy|launch\w*)\b')
    imported = {name for text in sources for name in names.findall(text)}
    assert 'geometry_msgs' in imported
    assert imported <= declared


def test_manifest_is_an_ament_python_package_of_format_3() -> None:
    assert MANIFEST.get('format') == '3'
    assert MANIFEST.findtext('export/build_type') == 'ament_python'
    assert MANIFEST.findtext('license') == 'Apache-2.0'
    assert 'Apache License' in (ROOT / 'LICENSE').read_text()
