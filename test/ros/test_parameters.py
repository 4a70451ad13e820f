# SPDX-License-Identifier: Apache-2.0
"""Settings as ROS parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from ros_support import BAG, ROOT, Client, NodeProcess, Tracker

from gsdf_registration.common.config import Config, settings

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
DOUBLE, STRING, STRINGS, DOUBLES, INTEGER = (Parameter.Type.DOUBLE, Parameter.Type.STRING,
                                             Parameter.Type.STRING_ARRAY,
                                             Parameter.Type.DOUBLE_ARRAY, Parameter.Type.INTEGER)
NAMES = Parameter('landmarks.names', STRINGS, ['one'])
POSITIONS = Parameter('landmarks.positions', DOUBLES, [0.0, 0.1, 0.2])


def value_of(client: Client, name: str) -> Any:
    request = GetParameters.Request(names=[name])
    response = client.result(client.start(GetParameters, 'get_parameters', request))
    return parameter_value_to_python(response.values[0])


def set_one_by_one(client: Client, parameters: list[Parameter]) -> list[str]:
    """Set them like ``ros2 param load``; return the reason of each rejection, empty if set."""
    request = SetParameters.Request(parameters=[each.to_parameter_msg() for each in parameters])
    results = client.result(client.start(SetParameters, 'set_parameters', request)).results
    return ['' if result.successful else result.reason for result in results]


def test_declares_and_describes_every_setting(client: Client) -> None:
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
        assert ('configured' in descriptor.additional_constraints) == about['fixed'], name
        assert all(choice in descriptor.additional_constraints for choice in about['choices'])
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert [(r.from_value, r.to_value) for r in ranges] == (
            [] if about['low'] is None else [(about['low'], about['high'])]), name
        kind = {bool: 1, int: 2, float: 3, str: 4}.get(type(Config().flat()[name]))
        assert descriptor.type == (kind or (8 if setting.metadata['items'] is float else 9)), name


@pytest.mark.parametrize('parameter, reason', [
    (Parameter('gate.max_speed', DOUBLE, -1.0), 'gate.max_speed must lie in [0, 100] m/s, not -1'),
    (Parameter('gate.max_speed', STRING, 'fast'), "gate.max_speed must be a finite number, not 'f"),
    (Parameter('gate.max_speed', DOUBLE, float('nan')), 'gate.max_speed must be a finite number'),
    (Parameter('gate.max_speed'), 'gate.max_speed must be a finite number, not None'),
    (Parameter('limits.min_points', DOUBLE, 30.5), 'limits.min_points must be a whole number'),
    (Parameter('solver.method', STRING, 'magic'), 'solver.method must be one of mixture, paper'),
    (Parameter('probe.topics', STRINGS, ['no topic!']), '"no topic!" is not a valid topic name'),
    (Parameter('probe.topics', STRINGS, ['/a', '/a']), '/a occurs twice'),
    (Parameter('model.frame_id', STRING, 'other'), 'deactivate and cleanup'),
    (Parameter('reference.topic', STRING, '/array'), 'deactivate and cleanup'),
    (Parameter('model.path', STRING, 'no/such.stl'), 'does not exist'),
    (Parameter('model.path', STRING, ''), 'deactivate and cleanup'),
], ids=lambda value: f'{value.name}={value.value}' if isinstance(value, Parameter) else '')
def test_rejects_an_invalid_value_with_a_reason(client: Client, parameter: Parameter,
                                                      reason: str) -> None:
    before = value_of(client, parameter.name)
    assert reason in client.set_parameters(parameter)
    assert value_of(client, parameter.name) == before


def test_suggests_the_right_name_for_a_misspelt_one(client: Client) -> None:
    misspelt = Parameter('gate.max_sped', DOUBLE, 0.5)
    assert 'did you mean gate.max_speed?' in client.set_parameters(misspelt)
    assert 'did you mean gate.max_speed?' in set_one_by_one(client, [misspelt])[0]


def test_sets_all_parameters_of_a_request_or_none(client: Client) -> None:
    good = Parameter('gate.max_gap', DOUBLE, 0.75)
    assert client.set_parameters(good, Parameter('solver.method', STRING, 'magic')) != ''
    assert value_of(client, 'gate.max_gap') == Config().gate.max_gap
    kept = [Parameter(name, kind, list(value_of(client, name)))
            for name, kind in (('landmarks.names', STRINGS), ('landmarks.positions', DOUBLES))]
    assert client.set_parameters(NAMES, POSITIONS) == ''
    assert '"one"' in client.ask('capture_landmark').message
    assert client.set_parameters(*kept) == ''


def test_does_not_rename_a_captured_landmark(tracker: Tracker) -> None:
    client = tracker.client
    names, numbers = value_of(client, 'landmarks.names'), value_of(client, 'landmarks.positions')
    tracker.touch_landmarks(np.eye(4))
    renamed = [Parameter('landmarks.names', STRINGS, ['other', *names[1:]]),
               Parameter('landmarks.positions', DOUBLES, list(numbers))]
    assert f'landmark "{names[0]}" is captured; clear' in client.set_parameters(*renamed)
    more = [Parameter('landmarks.names', STRINGS, ['fourth', *names]),
            Parameter('landmarks.positions', DOUBLES, [0.0, 0.0, 0.0, *numbers])]
    assert client.set_parameters(*more) == ''
    assert '"fourth"' in client.ask('capture_landmark').message
    client.ask('clear')
    assert client.set_parameters(Parameter('landmarks.names', STRINGS, list(names)),
                                 Parameter('landmarks.positions', DOUBLES, list(numbers))) == ''


def test_change_takes_effect_immediately(client: Client) -> None:
    assert client.set_parameters(Parameter('limits.min_points', INTEGER, 77)) == ''
    assert '77 are needed' in client.ask('register').message
    assert client.set_parameters(Parameter('limits.min_points', INTEGER,
                                           Config().limits.min_points)) == ''


def test_accepts_integers_for_doubles_and_empty_lists_of_any_type(client: Client) -> None:
    assert client.set_parameters(Parameter('gate.max_speed', INTEGER, 2)) == ''
    assert value_of(client, 'gate.max_speed') == 2.0
    assert client.set_parameters(Parameter('gate.max_speed', DOUBLE, 1.0)) == ''
    # the type that ros2 param assumes for []
    assert client.set_parameters(Parameter('targets.names', Parameter.Type.BOOL_ARRAY, [])) == ''
    assert value_of(client, 'targets.names') == []


def test_accepts_all_present_values_again(client: Client) -> None:
    names = [name for name, _ in settings()]
    request = GetParameters.Request(names=names)
    present = client.result(client.start(GetParameters, 'get_parameters', request)).values
    again = [Parameter.from_parameter_msg(Parameter(name).to_parameter_msg()) for name in names]
    again = [Parameter(each.name, Parameter.Type(value.type), parameter_value_to_python(value))
             for each, value in zip(again, present)]
    assert set(set_one_by_one(client, again)) == {''}


def test_keeps_points_when_the_probe_topic_changes(start_node: StartNode) -> None:
    node = start_node('probed')
    with Client(node) as client:
        client.await_state('active')
        first, second = (Tracker(client, topics=[topic]) for topic in ('/probe/tip', '/other/tip'))
        first.await_listener()
        first.send(first.positions[:20])
        client.status(kept='20')
        assert client.set_parameters(Parameter('probe.topics', STRINGS, ['/other/tip'])) == ''

        def received() -> bool:
            second.send(second.positions[20:21], topic='/other/tip')
            return int(client.status()['kept']) > 20
        client.spin_until(received, 'no point of the other probe is received')
        assert client.status()['frame_id'] == 'tracker'


def test_fixed_parameters_can_be_set_before_configuring(start_node: StartNode) -> None:
    node = start_node('before', autostart='false')
    with Client(node) as client:
        assert client.set_parameters(Parameter('model.frame_id', STRING, 'femur')) == ''
        assert value_of(client, 'model.frame_id') == 'femur'


def test_replaces_the_bone_while_points_are_collected(start_node: StartNode,
                                                    parameters: dict[str, Any]) -> None:
    hip, femur = (BAG.parent / f'{name}.ply' for name in ('hip', 'femur'))
    node = start_node('reloaded', **parameters | {
        'model.path': femur, 'probe.topics': ['/probe/tip'], 'collect.automatic': 'true',
        'limits.max_error': '0.01'})
    with Client(node) as client:
        client.await_state('active')
        tracker = Tracker(client, topics=['/probe/tip'])
        tracker.await_listener()
        tracker.send(tracker.positions, tracker.steps)
        kept = client.status(received=str(len(tracker.positions)))['kept']
        assert not client.ask('register').success       # the wrong bone
        right = Parameter('model.path', STRING, str(hip))
        assert client.set_parameters(right) == ''
        # the node answers while it loads the bone
        assert str(hip) in client.status()['message'] or 'is loaded' in node.log
        client.spin_until(lambda: f'{hip} is loaded' in node.log, 'the bone is not loaded')
        client.spin_until(lambda: 'landmarks and targets of the previous bone are dropped'
                          in client.status()['message'], 'the bone is not in use')
        assert client.status()['kept'] == kept
        assert value_of(client, 'landmarks.names') == []
        answer = client.ask('register')
        assert answer.success, answer.message

        def publisher() -> list[list[int]]:
            infos = client.node.get_publishers_info_by_topic('/reloaded/bone_pose')
            return [list(info.endpoint_gid) for info in infos]
        before = publisher()
        # with a landmark on the new bone, which does not apply to the current one
        assert client.set_parameters(Parameter('model.path', STRING, str(femur)), NAMES,
                                     POSITIONS) == ''
        assert client.status(pose='none')['kept'] == kept
        client.spin_until(lambda: 'next landmark is "one"' in client.status()['message'],
                          'the landmark of the new bone is not requested')
        assert value_of(client, 'landmarks.names') == ['one']
        # the pose of the hip is withdrawn: its latched message is gone with its publisher
        client.spin_until(lambda: publisher() != before, 'the previous pose is still published')


def test_keeps_the_bone_if_another_cannot_be_loaded(start_node: StartNode, tmp_path: Path,
                                                         parameters: dict[str, Any]) -> None:
    truncated = tmp_path / 'truncated.ply'
    truncated.write_bytes(Path(parameters['model.path']).read_bytes()[:5000])
    node = start_node('kept', **parameters)
    with Client(node) as client:
        client.await_state('active')
        assert client.set_parameters(Parameter('model.path', STRING, str(truncated))) == ''
        client.spin_until(lambda: 'the current bone is kept' in node.log, 'it is not reported')
        assert str(truncated) in client.status(state='idle')['message']
        assert value_of(client, 'model.path') == str(parameters['model.path'])
        assert client.set_parameters(Parameter('model.unit', STRING, 'm')) == ''
        client.spin_until(lambda: 'set model.path and model.unit in one request' in node.log,
                          'it is not explained')
        assert value_of(client, 'model.unit') == 'mm'
        assert 'too few' in client.ask('register').message       # with the current bone


@pytest.mark.parametrize('given, complaint', [
    ({'solver.metod': 'paper'}, 'did you mean solver.method?'),
    ({'gate.max_speed': 'fast'}, 'gate.max_speed must be a finite number'),
    ({'landmarks.names': "['one']"}, 'must have x, y, z for each of'),
    ({'probe.topics': "['no topic!']"}, 'is not a valid topic name'),
], ids=['misspelt', 'wrong type', 'no positions', 'no topic'])
def test_does_not_start_with_invalid_parameters(
        start_node: StartNode, given: dict[str, Any], complaint: str) -> None:
    node = start_node('wrong', **given)
    assert node.process.wait() == 2
    assert complaint in node.log
    assert len(node.log.splitlines()) == 1


@pytest.mark.parametrize('options', [['--params-file', 'no/such.yaml'], ['--no-such-option']],
                         ids=['no file', 'no option'])
def test_does_not_start_with_invalid_ros_arguments(start_node: StartNode,
                                                       options: list[str]) -> None:
    node = start_node('invalid', options=options)
    assert node.process.wait() == 2
    assert options[-1] in node.log.splitlines()[-1]
    assert 'Traceback' not in node.log


def test_starts_with_the_shipped_parameter_files(start_node: StartNode) -> None:
    files = [word for name in ('registration', 'ots')
             for word in ('--params-file', f'{ROOT}/config/{name}.yaml')]
    node = start_node('from_files', options=files, **{'gate.max_speed': '2'})
    with Client(node) as client:
        client.await_state('active')
        assert value_of(client, 'landmarks.names') == []
        assert value_of(client, 'gate.max_gap') == 0.25
        assert value_of(client, 'gate.max_speed') == 2.0
