# SPDX-License-Identifier: Apache-2.0
"""The settings as ROS parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from ros_support import ROOT, Client, NodeProcess

from gsdf_registration.config import Config, settings

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
DOUBLE, STRING, STRINGS, DOUBLES, INTEGER = (Parameter.Type.DOUBLE, Parameter.Type.STRING,
                                             Parameter.Type.STRING_ARRAY,
                                             Parameter.Type.DOUBLE_ARRAY, Parameter.Type.INTEGER)


def value_of(client: Client, name: str) -> Any:
    request = GetParameters.Request(names=[name])
    response = client.result(client.start(GetParameters, 'get_parameters', request))
    return parameter_value_to_python(response.values[0])


def test_every_setting_is_declared_and_described(client: Client) -> None:
    names = [name for name, _ in settings()]
    listed = client.result(client.start(ListParameters, 'list_parameters',
                                        ListParameters.Request()))
    assert set(names) <= set(listed.result.names)
    described = client.result(
        client.start(DescribeParameters, 'describe_parameters',
                     DescribeParameters.Request(names=names))).descriptors
    for (name, setting), descriptor in zip(settings(), described):
        about = setting.metadata
        assert descriptor.description.startswith(about['description'])
        assert descriptor.read_only == about['fixed']
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert [(r.from_value, r.to_value) for r in ranges] == (
            [] if about['low'] is None else [(about['low'], about['high'])]), name
        kind = {bool: 1, int: 2, float: 3, str: 4}.get(type(Config().flat()[name]))
        assert descriptor.type == (kind or (8 if name.endswith('positions') else 9)), name


@pytest.mark.parametrize('parameter, reason', [
    (Parameter('gate.max_speed', DOUBLE, -1.0), 'gate.max_speed'),
    (Parameter('gate.max_speed', INTEGER, 2), 'DOUBLE'),
    (Parameter('solver.method', STRING, 'magic'), 'must be one of'),
    (Parameter('landmarks.names', STRINGS, ['one']), 'give x y z for each'),
    (Parameter('probe.topics', STRINGS, ['/other']), 'read-only'),
    (Parameter('model.path', STRING, 'other.stl'), 'deactivate and cleanup'),
], ids=lambda value: value.name if isinstance(value, Parameter) else '')
def test_what_cannot_be_used_is_refused_with_a_reason(client: Client, parameter: Parameter,
                                                      reason: str) -> None:
    before = value_of(client, parameter.name)
    assert reason in client.set_parameters(parameter)
    assert value_of(client, parameter.name) == before


def test_all_of_a_request_or_none(client: Client) -> None:
    good = Parameter('gate.max_gap', DOUBLE, 0.75)
    assert client.set_parameters(good, Parameter('solver.method', STRING, 'magic')) != ''
    assert value_of(client, 'gate.max_gap') == Config().gate.max_gap
    landmarks = [Parameter('landmarks.names', STRINGS, ['one']),
                 Parameter('landmarks.positions', DOUBLES, [0.0, 0.1, 0.2])]
    kept = [Parameter(name, kind, list(value_of(client, name)))
            for name, kind in (('landmarks.names', STRINGS), ('landmarks.positions', DOUBLES))]
    assert client.set_parameters(*landmarks) == ''
    assert '"one"' in client.ask('capture_landmark').message
    assert client.set_parameters(*kept) == ''


def test_a_change_takes_effect_at_once(client: Client) -> None:
    assert client.set_parameters(Parameter('limits.min_points', INTEGER, 77)) == ''
    assert '77 are needed' in client.ask('register').message
    assert client.set_parameters(Parameter('limits.min_points', INTEGER,
                                           Config().limits.min_points)) == ''


@pytest.mark.parametrize('given, complaint', [
    ({'solver.metod': 'paper'}, 'unknown parameter "solver.metod"'),
    ({'gate.max_speed': '20'}, '20.0, not 20'),
    ({'gate.max_speed': '-1.0'}, 'gate.max_speed'),
    ({'landmarks.names': "['one']"}, 'give x y z for each'),
], ids=['misspelt', 'integer', 'out of range', 'no positions'])
def test_a_node_does_not_start_on_parameters_it_cannot_use(
        start_node: StartNode, given: dict[str, Any], complaint: str) -> None:
    node = start_node('wrong', **given)
    assert node.process.wait() == 2
    assert complaint in node.log
    assert len(node.log.splitlines()) == 1


def test_the_shipped_settings_are_a_parameter_file(start_node: StartNode) -> None:
    files = [word for name in ('registration', 'ots')
             for word in ('--params-file', f'{ROOT}/config/{name}.yaml')]
    node = start_node('filed', options=files)
    with Client(node) as client:
        client.await_state('active')
        assert value_of(client, 'landmarks.names') == []
        assert value_of(client, 'gate.max_gap') == 0.25
