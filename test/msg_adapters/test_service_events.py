# SPDX-License-Identifier: Apache-2.0
"""Requests of an operator are read from the service introspection of a node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_operation import (
    NODE,
    initial_pose_message,
    message,
    parameter,
    parameter_result,
    pose_body,
    service_event,
    service_part,
    transition_event,
)

from gsdf_registration.common.operator_event import BUSY
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import from_rt
from msg_adapters.bag import TYPES, read_bag
from msg_adapters.bag_storage import Raw
from msg_adapters.bag_writer import BagWriter
from msg_adapters.motion import POSE
from msg_adapters.recorded_events import events_source
from msg_adapters.service_events import (
    REQUEST_RECEIVED,
    RESPONSE_SENT,
    read_service_events,
)

TRIGGER, SET_BOOL = 'std_srvs/srv/Trigger', 'std_srvs/srv/SetBool'
SET_PARAMETERS = 'rcl_interfaces/srv/SetParameters'


class Introspection:
    """Messages of a node whose services are introspected."""

    def __init__(self) -> None:
        self.messages: list[Raw] = []

    def message(self, name: str, kind: str, *about: Any, **parts: Any) -> None:
        self.messages.append(Raw(f'{NODE}/{name}/_service_event', f'{kind}_Event',
                                 service_event(kind, *about, **parts), len(self.messages) + 1))

    def add(self, name: str, given: Any) -> None:
        """Add a message on another topic of the node."""
        self.messages.append(Raw(f'{NODE}/{name}', given.__msgtype__, bytes(TYPES.serialize_cdr(
            given, given.__msgtype__)), len(self.messages) + 1))

    def call(self, name: str, kind: str, *values: Any, answer: Any = (True, 'done'),
             more: bytes = b'') -> None:
        """Add a request and its response."""
        number = len(self.messages)
        self.message(name, kind, REQUEST_RECEIVED, number,
                     [service_part(kind, 'Request', *(values or (0,)))])
        self.message(name, kind, RESPONSE_SENT, number,
                     response=[service_part(kind, 'Response', *answer)], more=more)


def test_requests_with_contents_are_read_in_order() -> None:
    run = Introspection()
    run.call('collect', SET_BOOL, True)
    run.call('drop_stroke', 'gsdf_registration_msgs/srv/DropStroke', 3,
             more=b'further fields of the response')
    run.call('undo', TRIGGER, answer=(False, 'there is no stroke to undo'))
    run.call('typed/verify', 'gsdf_registration_msgs/srv/Verify', answer=(False, 'too far'))
    run.call('register', TRIGGER, answer=(False, BUSY))
    run.call('set_parameters', SET_PARAMETERS, [
        parameter('gate.min_distance', 0.002), parameter('probe.tip', [0.1, 0.2, 0.3]),
        parameter('gate.max_gap', 9.0), parameter('use_sim_time', True)],
        answer=([parameter_result(success) for success in (True, True, False, True)],))
    run.call('set_parameters', SET_PARAMETERS, [parameter('use_sim_time', True)],
             answer=([parameter_result(True)],))
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
    pose = message(POSE, 0.0, pose_body(from_rt(np.eye(3), [1.0, 2.0, 3.0])))
    run = Introspection()
    run.call('typed/register', 'gsdf_registration_msgs/srv/Register', True, pose)
    event = read_service_events(run.messages, NODE).events[1]
    assert event.name == 'register'
    np.testing.assert_array_equal(np.array(event.request['T_tracker_bone'])[:3, 3], [1.0, 2.0, 3.0])


def test_the_state_of_the_node_decides_which_requests_it_used() -> None:
    run = Introspection()

    def change(start: str, goal: str) -> None:
        run.add('transition_event', transition_event(start, goal))

    def initial_pose(T: np.ndarray) -> None:
        run.add('initial_pose', initial_pose_message(T))
    run.call('register', TRIGGER, answer=(False, 'the node is unconfigured'))
    run.call('set_parameters', SET_PARAMETERS, [parameter('gate.min_distance', 0.002)],
             answer=([parameter_result(True)],))
    change('unconfigured', 'configuring')
    change('configuring', 'unconfigured')       # no bone
    change('configuring', 'inactive')
    initial_pose(np.eye(4))
    change('inactive', 'activating')
    change('activating', 'active')
    initial_pose(from_rt(np.eye(3), [1.0, 2.0, 3.0]))
    initial_pose(from_rt(np.eye(3), [np.nan] * 3))      # rejected
    run.call('register', TRIGGER, answer=(False, 'too_few_points'))
    change('active', 'deactivating')
    change('deactivating', 'inactive')
    run.call('verify', TRIGGER, answer=(False, 'the node is inactive'))
    found = read_service_events(run.messages, NODE).events
    assert [(each.number, each.name, each.performed) for each in found] == [
        (0, 'register', False), (1, 'parameters', True), (2, 'configure', True),
        (3, 'initial_pose', False), (4, 'activate', True), (5, 'initial_pose', True),
        (6, 'register', True), (7, 'deactivate', True), (8, 'verify', False)]
    assert np.array(found[5].request['T_tracker_bone'])[:3, 3].tolist() == [1.0, 2.0, 3.0]
    assert found[5].request['frame_id'] == 'tracker'
    # of a node that was active when the recording began, all is carried out
    begin = next(row for row, raw in enumerate(run.messages) if 'register' in raw.topic and row > 5)
    found = read_service_events(run.messages[begin:], NODE).events
    assert [(each.name, each.performed) for each in found] == [
        ('activate', True), ('register', True), ('deactivate', True), ('verify', False)]


def test_a_request_without_an_answer_is_left_out_and_noted() -> None:
    run = Introspection()
    run.call('clear', TRIGGER)
    run.message('register', TRIGGER, REQUEST_RECEIVED, 99,
                [service_part(TRIGGER, 'Request', 0)])
    found = read_service_events(run.messages, NODE)
    assert [event.name for event in found.events] == ['activate', 'clear']
    assert found.notes[1] == 'requests to /registration without a recorded answer are left out: 1'


def test_metadata_alone_give_one_note_and_all_points(tmp_path: Path) -> None:
    run = Introspection()
    run.message('undo', TRIGGER, REQUEST_RECEIVED, 1)
    run.message('undo', TRIGGER, RESPONSE_SENT, 1)
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
