# SPDX-License-Identifier: Apache-2.0
"""The sources of gsdf_registration_msgs are complete, commented and in no Python package."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from gsdf_registration.common.result import Reason
from gsdf_registration.common.withdrawal import Withdrawal

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / 'gsdf_registration_msgs'
INTERFACES = sorted([*PACKAGE.glob('msg/*.msg'), *PACKAGE.glob('srv/*.srv')])
MANIFEST = ElementTree.parse(PACKAGE / 'package.xml').getroot()


def declared(tag: str) -> set[str | None]:
    return {element.text for element in MANIFEST.iter(tag)}


def test_every_reason_has_a_constant_of_its_name() -> None:
    text = (PACKAGE / 'msg/RegistrationResult.msg').read_text()
    constants = dict(re.findall(r'(?m)^uint8 ([A-Z_]+) = (\d+)', text))
    assert constants.keys() == {'UNKNOWN'} | {each.name for each in (*Reason, *Withdrawal)}
    assert len(set(constants.values())) == len(constants)
    assert constants['UNKNOWN'] == '0'     # a message that nobody filled in is not valid


@pytest.mark.parametrize('file', INTERFACES, ids=lambda file: file.name)
def test_every_field_has_a_comment(file: Path) -> None:
    lines = file.read_text().splitlines()
    assert lines[0].startswith('# ') and max(map(len, lines)) <= 120
    above = ''
    for line in lines:
        field = re.match(r'[\w/]+(\[\d*\])? [a-z]', line)
        assert not field or '# ' in line or above.startswith('# '), line
        above = line


def test_every_interface_is_generated() -> None:
    listed = re.findall(r'(?m)^  (\w+/\w+\.(?:msg|srv))$', (PACKAGE / 'CMakeLists.txt').read_text())
    assert listed == [file.relative_to(PACKAGE).as_posix() for file in INTERFACES]


def test_the_manifest_declares_every_package_used() -> None:
    used = {name for file in INTERFACES
            for name in re.findall(r'(?m)^(\w+)/', file.read_text())} - {PACKAGE.name}
    assert declared('depend') == used
    assert declared('buildtool_depend') == {'ament_cmake', 'rosidl_default_generators'}
    assert declared('exec_depend') == {'rosidl_default_runtime'}
    assert declared('member_of_group') == {'rosidl_interface_packages'}
    assert declared('build_type') == {'ament_cmake'}


def test_both_packages_have_the_same_version() -> None:
    other = ElementTree.parse(ROOT / 'package.xml').getroot()
    assert MANIFEST.findtext('version') == other.findtext('version')


def test_the_python_package_does_not_contain_it(source_copy: Path, tmp_path: Path) -> None:
    sources = shutil.copytree(source_copy, tmp_path / 'sources')
    (sources / 'gsdf_registration_msgs/__init__.py').touch()
    subprocess.run([sys.executable, 'setup.py', '--quiet', 'egg_info'], cwd=sources, check=True)
    names = (sources / 'gsdf_registration.egg-info/top_level.txt').read_text().split()
    assert sorted(names) == ['gsdf_registration', 'msg_adapters']
