# SPDX-License-Identifier: Apache-2.0
"""The C++ example, which is compiled only where ROS is installed."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / 'examples/cpp'
SOURCE = (FOLDER / 'robot_client.cpp').read_text()


def test_it_is_short() -> None:
    assert len(SOURCE.splitlines()) <= 60


def test_it_reads_fields_that_the_message_has() -> None:
    message = (ROOT / 'gsdf_registration_msgs/msg/RegistrationResult.msg').read_text()
    fields = set(re.findall(r'(?m)^[\w/]+(?:\[\])? (\w+)(?:\s|$)', message))
    used = set(re.findall(r'\bresult\.(\w+)', SOURCE))
    assert {'valid', 'grade', 'target_tre'} <= used <= fields


def test_its_package_builds_the_source() -> None:
    manifest = ElementTree.parse(FOLDER / 'package.xml').getroot()
    cmake = (FOLDER / 'CMakeLists.txt').read_text()
    assert f'project({manifest.findtext("name")})' in cmake
    assert 'add_executable(robot_client robot_client.cpp)' in cmake
    found = set(re.findall(r'find_package\((\w+) REQUIRED\)', cmake))
    declared = {each.text for each in manifest if each.tag in ('depend', 'buildtool_depend')}
    assert found == declared
