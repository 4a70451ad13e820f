# SPDX-License-Identifier: Apache-2.0
"""Requests of an operator are read from the service introspection of a node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsdf_registration.common.operator_event import BUSY
from gsdf_registration.common.result import InputError
from msg_adapters.bag import read_bag
from msg_adapters.bag_storage import Raw
from msg_adapters.bag_writer import BagWriter
from msg_adapters.recorded_events import events_source
from msg_adapters.service_events import (
    REQUEST_RECEIVED,
    RESPONSE_SENT,
    _typestore,
    read_service_events,
)

NODE = '/registration'
STORE = _typestore()
TYPES = STORE.types
TRIGGER, SET_BOOL = 'std_srvs/srv/Trigger', 'std_srvs/srv/SetBool'
SET_PARAMETERS = 'rcl_interfaces/srv/SetParameters'


def part(kind: str, which: str, *values: Any) -> Any:
    return TYPES[f'{kind.replace("/srv/", "/msg/")}_{which}'](*values)


class Introspection:
    """Messages of a node whose services are introspected."""

    def __init__(self) -> None:
        self.messages: list[Raw] = []
        self._time = 0

    def message(self, name: str, kind: str, event_type: int, number: int, request: list[Any],
                response: list[Any], more: bytes = b'') -> None:
        self._time += 1
        types = TYPES
        info = types['service_msgs/msg/ServiceEventInfo'](
            event_type, types['builtin_interfaces/msg/Time'](5, 500_000_000),
            np.zeros(16, np.uint8), number)
        event = part(kind, 'Event', info, request, response)
        data = bytes(STORE.serialize_cdr(event, event.__msgtype__)) + more
        self.messages.append(Raw(f'{NODE}/{name}/_service_event', f'{kind}_Event', data,
                                 self._time))

    def call(self, name: str, kind: str, *values: Any, answer: Any = (True, 'done'),
             more: bytes = b'') -> None:
        """Add a request and its response."""
        number = self._time
        self.message(name, kind, REQUEST_RECEIVED, number,
                     [part(kind, 'Request', *(values or (0,)))], [])
        self.message(name, kind, RESPONSE_SENT, number, [], [part(kind, 'Response', *answer)],
                     more)


def parameter(name: str, kind: int, **value: Any) -> Any:
    given = {'bool_value': False, 'integer_value': 0, 'double_value': 0.0, 'string_value': '',
             'byte_array_value': np.zeros(0, np.uint8), 'bool_array_value': np.zeros(0, bool),
             'integer_array_value': np.zeros(0, np.int64), 'double_array_value': np.zeros(0),
             'string_array_value': []}
    return TYPES['rcl_interfaces/msg/Parameter'](
        name, TYPES['rcl_interfaces/msg/ParameterValue'](type=kind, **{**given, **value}))


def result(success: bool) -> Any:
    return TYPES['rcl_interfaces/msg/SetParametersResult'](success, '')


def test_requests_with_contents_are_read_in_order() -> None:
    run = Introspection()
    run.call('collect', SET_BOOL, True)
    run.call('drop_stroke', 'gsdf_registration_msgs/srv/DropStroke', 3,
             more=b'further fields of the response')
    run.call('undo', TRIGGER, answer=(False, 'there is no stroke to undo'))
    run.call('typed/verify', 'gsdf_registration_msgs/srv/Verify', answer=(False, 'too far'))
    run.call('register', TRIGGER, answer=(False, BUSY))
    run.call('set_parameters', SET_PARAMETERS, [
        parameter('gate.min_distance', 3, double_value=0.002),
        parameter('probe.tip', 8, double_array_value=np.array([0.1, 0.2, 0.3])),
        parameter('gate.max_gap', 3, double_value=9.0),
        parameter('use_sim_time', 1, bool_value=True)],
        answer=([result(True), result(True), result(False), result(True)],))
    run.call('set_parameters', SET_PARAMETERS, [parameter('use_sim_time', 1, bool_value=True)],
             answer=([result(True)],))
    found = read_service_events(run.messages, NODE)
    assert [(each.name, each.request, each.performed) for each in found.events] == [
        ('activate', {}, True), ('collect', {'data': True}, True),
        ('drop_stroke', {'stroke': 3}, True), ('undo', {}, False), ('verify', {}, True),
        ('register', {}, False),
        ('parameters', {'gate.min_distance': 0.002, 'probe.tip': [0.1, 0.2, 0.3]}, True)]
    assert found.received == [0, 1, 3, 5, 7, 9, 11]
    assert found.events[1].stamp == 5.5 and found.events[3].message.startswith('there is no stroke')
    note, = found.notes
    assert 'where the recorder received it' in note


def test_an_initial_pose_is_read() -> None:
    turn = TYPES['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    pose = TYPES['geometry_msgs/msg/Pose'](TYPES['geometry_msgs/msg/Point'](1.0, 2.0, 3.0), turn)
    header = TYPES['std_msgs/msg/Header'](TYPES['builtin_interfaces/msg/Time'](0, 0), '')
    run = Introspection()
    run.call('typed/register', 'gsdf_registration_msgs/srv/Register', True,
             TYPES['geometry_msgs/msg/PoseStamped'](header, pose))
    event = read_service_events(run.messages, NODE).events[1]
    assert event.name == 'register'
    np.testing.assert_array_equal(np.array(event.request['T_tracker_bone'])[:3, 3], [1.0, 2.0, 3.0])


def test_a_request_without_an_answer_is_left_out_and_noted() -> None:
    run = Introspection()
    run.call('clear', TRIGGER)
    run.message('register', TRIGGER, REQUEST_RECEIVED, 99, [part(TRIGGER, 'Request', 0)], [])
    found = read_service_events(run.messages, NODE)
    assert [event.name for event in found.events] == ['activate', 'clear']
    assert found.notes[1] == 'requests to /registration without a recorded answer are left out: 1'


def test_metadata_alone_give_one_note_and_all_points(tmp_path: Path) -> None:
    run = Introspection()
    run.message('undo', TRIGGER, REQUEST_RECEIVED, 1, [], [])
    run.message('undo', TRIGGER, RESPONSE_SENT, 1, [], [])
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write_point('/probe/tip', 1.0, [0.0, 0.0, 0.0], 'tracker')
        for raw in run.messages:
            if raw.topic not in bag.counts:
                bag.add_topic(raw.topic, raw.msgtype, 'not needed')
            bag.write(raw.topic, raw.received, raw.data)
    recording = read_bag(tmp_path / 'bag', events=None)
    assert not recording.events and len(recording) == 1
    note, = recording.notes
    assert note.startswith('the requests to /registration were recorded as metadata')
    assert 'set service_configure_introspection of the node to contents' in note
    assert not read_bag(tmp_path / 'bag', events='').notes


def test_the_node_is_found_by_its_services() -> None:
    types = {f'/left/{NODE[1:]}/typed/register/_service_event': f'{TRIGGER}_Event',
             '/other/set_parameters/_service_event': f'{SET_PARAMETERS}_Event'}
    assert events_source(types, None) == '/left/registration'
    assert events_source(types, '') == ''
    both = types | {'/right/undo/_service_event': f'{TRIGGER}_Event'}
    with pytest.raises(InputError, match='several nodes: /left/registration, /right; choose'):
        events_source(both, None)
    assert events_source(both, '/right') == '/right'
    status = {'/right/events': 'diagnostic_msgs/msg/DiagnosticStatus'}
    assert events_source(both | status, None) == '/right/events'    # it says more


def test_a_damaged_message_is_named() -> None:
    run = Introspection()
    run.call('undo', TRIGGER)
    damaged = run.messages[0]._replace(data=run.messages[0].data[:20])
    with pytest.raises(InputError, match='/registration/undo/_service_event cannot be decoded'):
        read_service_events([damaged], NODE)
