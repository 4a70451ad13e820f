# SPDX-License-Identifier: Apache-2.0
"""
Read what an operator did from the service introspection of a node, where it was switched on.

A node without ~/events in the recording may have published its requests and responses on
``<service>/_service_event``, see service_msgs/ServiceEventInfo and REP 2012. Its state and initial
poses are read from two of its topics: rclpy cannot introspect ``change_state``.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gsdf_registration.common.config import settings
from gsdf_registration.common.operator_event import BUSY, UNKNOWN, OperatorEvent
from gsdf_registration.common.result import InputError
from msg_adapters import stamps
from msg_adapters.bag_storage import Raw
from msg_adapters.motion import to_matrix

SUFFIX = '/_service_event'
REQUEST_RECEIVED, RESPONSE_SENT = 1, 2      # of service_msgs/ServiceEventInfo
# type of a request without fields
EMPTY = 'uint8 structure_needs_at_least_one_member'
# the fields that the response of every service of the node begins with; the others are not read
ANSWER = 'bool success\nstring message'
PARAMETERS = 'rcl_interfaces/msg/Parameter[] parameters'
RESULT = 'rcl_interfaces/msg/SetParametersResult'
# request and response of each service type
SERVICES = {
    'std_srvs/srv/Trigger': (EMPTY, ANSWER),
    'std_srvs/srv/SetBool': ('bool data', ANSWER),
    'gsdf_registration_msgs/srv/Register': (
        'bool use_initial_pose\ngeometry_msgs/msg/PoseStamped initial_pose', ANSWER),
    'gsdf_registration_msgs/srv/Verify': (EMPTY, ANSWER),
    'gsdf_registration_msgs/srv/CaptureLandmark': (EMPTY, ANSWER),
    'gsdf_registration_msgs/srv/DropStroke': ('uint32 stroke', ANSWER),
    'rcl_interfaces/srv/SetParameters': (PARAMETERS, f'{RESULT}[] results'),
    'rcl_interfaces/srv/SetParametersAtomically': (PARAMETERS, f'{RESULT} result'),
}
NAMES = ('collect', 'undo', 'drop_stroke', 'clear', 'capture_landmark', 'register', 'verify',
         'save', 'load', 'calibrate_tip', 'find_joint_centre', 'typed/register', 'typed/verify',
         'typed/capture_landmark')
SETTERS = ('set_parameters', 'set_parameters_atomically')
TRANSITION = 'lifecycle_msgs/msg/TransitionEvent'
INITIAL_POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
# topics that are read beside the services, and their types
TOPICS = {'transition_event': TRANSITION, 'initial_pose': INITIAL_POSE}
# what a node has done after a change between two states; after others, as failed ones, nothing
CHANGES = {('configuring', 'inactive'): 'configure', ('activating', 'active'): 'activate',
           ('deactivating', 'inactive'): 'deactivate'}
TYPES_OF_EVENTS = (*(f'{kind}_Event' for kind in SERVICES), TRANSITION, INITIAL_POSE)
# field of rcl_interfaces/ParameterValue by its type
VALUES = {1: 'bool_value', 2: 'integer_value', 3: 'double_value', 4: 'string_value',
          8: 'double_array_value', 9: 'string_array_value'}


class ServiceEvents(NamedTuple):
    """
    What an operator did, as service introspection recorded it.

    events : in order
    received : ns, when the recorder received each of them
    notes : sentences on what is not recorded
    """

    events: list[OperatorEvent]
    received: list[int]
    notes: list[str]


def introspected_nodes(types: dict[str, str]) -> list[str]:
    """Return the nodes with recorded requests; ``types``: of each topic."""
    endings = [f'/{name}{SUFFIX}' for name in NAMES]
    return sorted({topic.removesuffix(ending) for topic, kind in types.items()
                   for ending in endings if topic.endswith(ending) and kind in TYPES_OF_EVENTS
                   and not topic.removesuffix(ending).endswith('/typed')})


def service_topics(node: str) -> list[str]:
    """Return the topics with the requests, states and initial poses of a node."""
    return [f'{node}/{name}' for name in (*(f'{name}{SUFFIX}' for name in (*NAMES, *SETTERS)),
                                          *TOPICS)]


def read_service_events(messages: Sequence[Raw], node: str) -> ServiceEvents:
    """
    Return the requests that a node answered, the changes of its state, and its initial poses.

    Parameters
    ----------
    messages : sequence of Raw
        Of the topics of `service_topics`, in the order received.
    node : str

    Raises
    ------
    InputError
        If a message cannot be read.

    """
    requests: dict[tuple[Any, ...], tuple[int, Any]] = {}
    responses: dict[tuple[Any, ...], Any] = {}
    found: dict[int, OperatorEvent | None] = {}     # by the row of its message
    for row, raw in enumerate(messages):
        message = _decoded(raw)
        if not raw.topic.endswith(SUFFIX):
            found[row] = _topic_event(raw, message)
            continue
        key = (raw.topic, message.info.client_gid.tobytes(), message.info.sequence_number)
        if message.info.event_type == REQUEST_RECEIVED:
            requests[key] = row, message
        elif message.info.event_type == RESPONSE_SENT and len(message.response):
            responses[key] = message.response[0]
    bare = sum(not len(message.request) for _, message in requests.values())
    if bare:
        return ServiceEvents([], [], [
            f'the requests to {node} were recorded as metadata, without contents ({bare} of '
            f'{len(requests)}): what the operator did is not replayed, and all points are '
            'registered; set service_configure_introspection of the node to contents'])
    notes = [f'what the operator did is read from the service events of {node}: each request '
             'stands where the recorder received it, and the settings at the start are those of '
             'the command line']
    for key, (row, message) in requests.items():
        if key in responses:
            name = messages[row].topic[len(node) + 1:].removesuffix(SUFFIX)
            found[row] = _service_event(name, message, responses[key])
    unanswered = len(requests.keys() - responses.keys())
    if unanswered:
        notes.append(f'requests to {node} without a recorded answer are left out: {unanswered}')
    return ServiceEvents(*_with_state([(messages[row].received, event) for row, event in
                                       sorted(found.items()) if event is not None]), notes)


def _with_state(found: list[tuple[int, OperatorEvent]]) -> tuple[list[OperatorEvent], list[int]]:
    """Return events and times with the state of the node, which refuses requests if not active."""
    changes = [event.name for _, event in found if event.name in CHANGES.values()]
    active = changes[:1] in ([], ['deactivate'])    # at the start
    if active:
        found = [(0, _event('activate', 0.0)), *found]
    events = []
    for number, (_, event) in enumerate(found):
        if event.name in CHANGES.values():
            active = event.name == 'activate'
        performed = event.performed and (active or event.name in (*CHANGES.values(), 'parameters'))
        events.append(replace(event, number=number, performed=performed))
    return events, [time for time, _ in found]


def _event(name: str, stamp: float, **values: Any) -> OperatorEvent:
    """Return an event of which neither number, points nor follow-up are recorded."""
    return OperatorEvent(0, name, stamp, kept=UNKNOWN, follow_up='unknown', **values)


def _topic_event(raw: Raw, message: Any) -> OperatorEvent | None:
    """Return a change of the node's state, or an initial pose that it could use; else None."""
    if raw.msgtype == TRANSITION:
        name = CHANGES.get((message.start_state.label, message.goal_state.label))
        return None if name is None else _event(name, 1e-9 * raw.received)
    if raw.msgtype != INITIAL_POSE:     # not a topic of the node
        return None
    pose = message.pose.pose
    try:
        T = to_matrix(pose.position, pose.orientation)
    except InputError:      # the node rejected it
        return None
    return _event('initial_pose', 1e-9 * raw.received, request={
        'T_tracker_bone': T.tolist(), 'frame_id': message.header.frame_id})


def _service_event(name: str, message: Any, response: Any) -> OperatorEvent | None:
    """Return a request as an event; None if it has set no parameter of the node."""
    stamp = stamps.to_seconds(message.info.stamp.sec, message.info.stamp.nanosec)
    request = message.request[0]
    if name in SETTERS:
        values = _parameters(request, response)
        return _event('parameters', stamp, request=values) if values else None
    name = name.removeprefix('typed/')
    # a registration or verification that is refused by the session counts; see `OperatorEvent`
    performed = response.success or (name in ('register', 'verify') and response.message != BUSY)
    return _event(name, stamp, success=bool(response.success), message=response.message,
                  request=_values(request), performed=performed)


def _values(request: Any) -> dict[str, Any]:
    """Return the values of a request as those of an event."""
    values: dict[str, Any] = {}
    if hasattr(request, 'data'):
        values['data'] = bool(request.data)
    if hasattr(request, 'stroke'):
        values['stroke'] = int(request.stroke)
    if getattr(request, 'use_initial_pose', False):
        pose = request.initial_pose.pose
        with contextlib.suppress(InputError):       # the request was refused for it
            values['T_tracker_bone'] = to_matrix(pose.position, pose.orientation).tolist()
    return values


def _parameters(request: Any, response: Any) -> dict[str, Any]:
    """Return the settings that a request has changed, by dotted name."""
    results = response.results if hasattr(response, 'results') else (
        [response.result] * len(request.parameters))
    known = dict(settings())
    values = {}
    for each, result in zip(request.parameters, results):
        if result.successful and each.name in known and each.value.type in VALUES:
            value = getattr(each.value, VALUES[each.value.type])
            values[each.name] = value.tolist() if hasattr(value, 'tolist') else value
    return values


@functools.cache
def _typestore() -> Any:
    """Return a store of the types of all service events."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for kind, (request, response) in SERVICES.items():
        named = kind.replace('/srv/', '/msg/')
        store.register({
            **get_types_from_msg(request, f'{named}_Request'),
            **get_types_from_msg(response, f'{named}_Response'),
            **get_types_from_msg('service_msgs/msg/ServiceEventInfo info\n'
                                 f'{named}_Request[<=1] request\n{named}_Response[<=1] response',
                                 f'{named}_Event')})
    return store


def _decoded(raw: Raw) -> Any:
    """Return the event in a message, up to the end of `ANSWER`; raise `InputError` if damaged."""
    store = _typestore()
    definition = store.get_msgdef(raw.msgtype.replace('/srv/', '/msg/'))
    try:
        decode = (definition.deserialize_cdr_le if raw.data[1] else definition.deserialize_cdr_be)
        return decode(raw.data[4:], 0, definition.cls, store)[0]
    except Exception:  # noqa: BLE001 - damaged bytes can cause any exception in the decoder
        raise InputError(f'a message on {raw.topic} cannot be decoded; replay the points alone '
                         'with --events none') from None
