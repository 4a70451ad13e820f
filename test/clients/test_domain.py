# SPDX-License-Identifier: Apache-2.0
"""A private ROS domain is reserved for the block only, and visible on this machine only."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gsdf_registration.clients.domain import private_domain


def test_two_domains_at_the_same_time_differ() -> None:
    with private_domain() as first, private_domain() as second:
        assert first['ROS_DOMAIN_ID'] != second['ROS_DOMAIN_ID']


def test_environment_limits_discovery_to_this_machine() -> None:
    with private_domain() as environment:
        assert environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
        assert 1 <= int(environment['ROS_DOMAIN_ID']) <= 101
        assert environment['PATH'] == os.environ['PATH']


def test_discovery_profile_exists_during_the_block() -> None:
    with private_domain() as environment:
        profile = Path(environment['FASTRTPS_DEFAULT_PROFILES_FILE'])
        assert 'quick_discovery' in profile.read_text()


def test_keeps_a_discovery_profile_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', '/somewhere/profile.xml')
    with private_domain() as environment:
        assert environment['FASTRTPS_DEFAULT_PROFILES_FILE'] == '/somewhere/profile.xml'
