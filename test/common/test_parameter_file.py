# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files: sections of other nodes, foreign parameters and misspelt ones."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from gsdf_registration.common.config import Config, settings
from gsdf_registration.common.parameter_file import is_foreign, parameters_of_file
from gsdf_registration.common.result import InputError

KNOWN = dict(settings())
OURS = {'ros__parameters': {'gate': {'max_speed': 0.5}, 'use_sim_time': True}}
CAMERA = {'ros__parameters': {'exposure': 3}}


@pytest.mark.parametrize('values', [
    OURS,
    {'/**': OURS},
    {'some_name': OURS},
    {'/femur/registration': OURS},
    {'/femur': {'registration': OURS}},
    {'/femur': {'registration': OURS}, '/camera': CAMERA},
    {'/femur': OURS, '/camera': CAMERA},
    {'/**': {'ros__parameters': {'gate.max_speed': 2.0}}, 'registration': OURS},
])
def test_finds_the_parameters_of_the_registration_node(values: dict[str, Any]) -> None:
    assert parameters_of_file(values, KNOWN) == {'gate.max_speed': 0.5}
    assert Config.from_nested(values).gate.max_speed == 0.5


def test_a_file_without_ros_sections_has_settings_only() -> None:
    assert parameters_of_file({'gate': {'max_speed': 0.5}}, KNOWN) is None
    with pytest.raises(InputError, match='unknown parameter "robot_name"'):
        Config.from_nested({'robot_name': 'meca'})


@pytest.mark.parametrize('values, sentence', [
    ({'/femur/registration': OURS, '/tibia/registration': OURS},
     'sections for /femur/registration and /tibia/registration; give a file'),
    ({'/camera': CAMERA, '/robot': CAMERA}, 'sections for /camera, /robot, but none for a node'),
])
def test_rejects_sections_of_several_nodes_or_of_none(values: dict[str, Any],
                                                      sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Config.from_nested(values)


@pytest.mark.parametrize('name', ['robot_name', 'exposure', 'controller.gains.p', 'x' * 100_000])
def test_a_name_that_resembles_no_setting_is_foreign(name: str) -> None:
    assert is_foreign(name, KNOWN)


@pytest.mark.parametrize('name', ['gate.max_sped', 'model.nothing_alike', 'gat.max_speed',
                                  'probe_topics', 'gate'])
def test_a_misspelt_setting_is_not_foreign(name: str) -> None:
    assert not is_foreign(name, KNOWN)


def test_warns_once_of_foreign_parameters(caplog: pytest.LogCaptureFixture) -> None:
    given = {'robot_name': 'meca', 'rate': 50, 'gate': {'max_speed': 0.5}}
    with caplog.at_level(logging.WARNING):
        config = Config.from_nested({'/**': {'ros__parameters': given}})
    assert config.gate.max_speed == 0.5
    assert [record.message for record in caplog.records] == [
        'ignored parameters that this program does not have: rate, robot_name']


def test_a_misspelt_setting_in_a_ros_file_is_an_error() -> None:
    with pytest.raises(InputError, match='did you mean gate.max_speed?'):
        Config.from_nested({'/**': {'ros__parameters': {'gate': {'max_sped': 0.5}}}})
