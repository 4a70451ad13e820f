# SPDX-License-Identifier: Apache-2.0
"""An operation, carried out on a session as the node does, and the recording of its topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.operator_event import BUSY, OperatorEvent
from gsdf_registration.common.rigid import Array, quaternion_from_rotation
from gsdf_registration.common.samples import Sample
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.session import Answer, Session
from gsdf_registration.session.calibration import CalibrationKind
from gsdf_registration.tracking.pivot import FixedPoint
from gsdf_registration.tracking.point_transformer import PointTransformer
from msg_adapters import stamps
from msg_adapters.bag import TYPES
from msg_adapters.bag_writer import BagWriter
from msg_adapters.motion import POINT, POSE, to_matrix, tool_pose
from msg_adapters.service_events import (
    INITIAL_POSE,
    REQUEST_RECEIVED,
    RESPONSE_SENT,
    TRANSITION,
    _typestore,
)

STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
NODE = '/registration'
EVENTS, TIP, TOOL, ARRAY = f'{NODE}/events', '/probe/tip', '/probe/tool', '/array'
SERVICE_STORE = _typestore()
SERVICE_TYPES = SERVICE_STORE.types
START, STEP = 1.7e9, 0.0125     # s
TICK = 0.1      # s, between two checks of the node for samples that waited too long


def message(kind: str, stamp: float, body: Any, frame_id: str = 'tracker') -> Any:
    """Return a message with a header."""
    t, time = TYPES.types, stamps.to_nanoseconds(stamp)
    header = t['std_msgs/msg/Header'](t['builtin_interfaces/msg/Time'](*stamps.split(time)),
                                      frame_id)
    return t[kind](header, body)


def pose_body(T: Array, quaternion: Array | None = None) -> Any:
    """Return a Pose; ``quaternion``: in place of that of ``T``."""
    t = TYPES.types
    turn = quaternion_from_rotation(T[:3, :3]) if quaternion is None else quaternion
    return t['geometry_msgs/msg/Pose'](point_body(T[:3, 3]),
                                       t['geometry_msgs/msg/Quaternion'](*map(float, turn)))


def point_body(position: Array) -> Any:
    """Return a Point."""
    return TYPES.types['geometry_msgs/msg/Point'](*map(float, position))


def event_message(event: OperatorEvent) -> bytes:
    """Return an event as the node publishes it, as CDR."""
    t = TYPES.types
    values = [t['diagnostic_msgs/msg/KeyValue'](*pair) for pair in event.values().items()]
    status = t[STATUS](0, '/registration', event.message, '', values)
    return bytes(TYPES.serialize_cdr(status, STATUS))


def service_event(kind: str, event_type: int, number: int, request: Sequence[Any] = (),
                  response: Sequence[Any] = (), more: bytes = b'') -> bytes:
    """Return a message of service introspection, as CDR; ``more``: further fields, not known."""
    info = SERVICE_TYPES['service_msgs/msg/ServiceEventInfo'](
        event_type, SERVICE_TYPES['builtin_interfaces/msg/Time'](5, 500_000_000),
        np.zeros(16, np.uint8), number)
    event = service_part(kind, 'Event', info, list(request), list(response))
    return bytes(SERVICE_STORE.serialize_cdr(event, event.__msgtype__)) + more


def service_part(kind: str, which: str, *values: Any) -> Any:
    """Return a Request, Response or Event of a service type."""
    return SERVICE_TYPES[f'{kind.replace("/srv/", "/msg/")}_{which}'](*values)


def transition_event(start: str, goal: str) -> Any:
    """Return a change of state as rcl publishes it."""
    t = TYPES.types
    state = t['lifecycle_msgs/msg/State']
    return t[TRANSITION](0, t['lifecycle_msgs/msg/Transition'](0, ''), state(0, start),
                         state(0, goal))


def initial_pose_message(T: Array, frame_id: str = 'tracker') -> Any:
    """Return an initial pose (4, 4)."""
    body = TYPES.types['geometry_msgs/msg/PoseWithCovariance'](pose_body(T), np.zeros(36))
    return message(INITIAL_POSE, 0.0, body, frame_id)


def parameter(name: str, value: Any) -> Any:
    """Return a Parameter message."""
    kinds = [(bool, 1, 'bool_value'), (int, 2, 'integer_value'), (float, 3, 'double_value'),
             (str, 4, 'string_value'), (list, 8, 'double_array_value')]
    number, field = next((number, field) for kind, number, field in kinds
                         if isinstance(value, kind))
    if number == 8 and value and isinstance(value[0], str):
        number, field = 9, 'string_array_value'
    values = {'bool_value': False, 'integer_value': 0, 'double_value': 0.0, 'string_value': '',
              'byte_array_value': np.zeros(0, np.uint8), 'bool_array_value': np.zeros(0, bool),
              'integer_array_value': np.zeros(0, np.int64), 'double_array_value': np.zeros(0),
              'string_array_value': []}
    values[field] = np.array(value) if number == 8 else value
    return SERVICE_TYPES['rcl_interfaces/msg/Parameter'](
        name, SERVICE_TYPES['rcl_interfaces/msg/ParameterValue'](type=number, **values))


def parameter_result(success: bool) -> Any:
    """Return a SetParametersResult message."""
    return SERVICE_TYPES['rcl_interfaces/msg/SetParametersResult'](success, '')


class RecordedOperation:
    """
    A session with the samples and requests that it receives, and the messages of a recording.

    Attributes
    ----------
    time : float
        Of the last sample, s after `START`; the next one is `STEP` later.
    messages : list of (float, str, str, bytes)
        Time of publication, s, topic, type and CDR of each message.
    points : (n, 3), m, tracker frame, for the tests
    services : the same of service introspection, state and initial poses

    """

    def __init__(self, field: Field, config: Config) -> None:
        self.session = Session(config, field)
        self.time = 0.0
        self.messages: list[tuple[float, str, str, bytes]] = []
        self.points = np.empty((0, 3))
        self.services: list[tuple[float, str, str, bytes]] = []
        self._transformer = PointTransformer(self.session, None)
        self._last: dict[str, tuple[int, float]] = {}
        self._number = 0
        self._ticked = 0.0
        self._start: Any = None     # Pose of the last request with one
        self._active = True
        self._field = field
        for name in ('configure', 'activate'):
            self._publish(self._begin(name, self._state()), Answer(True, ''))
        self.session.activate()

    # what the tracker sends

    def tip(self, positions: Array) -> None:
        """Receive positions (n, 3) of the tip, m, tracker frame."""
        for position in positions:
            self.time += STEP
            self.sample(message(POINT, START + self.time, point_body(position)), TIP)

    def tool(self, T: Array, quaternion: Array | None = None) -> None:
        """Receive poses (n, 4, 4) of the tool, m."""
        for each in T:
            self.time += STEP
            self.sample(message(POSE, START + self.time, pose_body(each, quaternion)), TOOL)

    def sample(self, given: Any, topic: str) -> None:
        """Receive a message of the probe, now."""
        given = self._record(given, topic)
        stamp = stamps.to_seconds(given.header.stamp.sec, given.header.stamp.nanosec)
        arrival = START + self.time
        if topic == TIP:
            at = given.point
            sample = Sample(stamp, (at.x, at.y, at.z), given.header.frame_id, topic, arrival)
        else:
            tool = tool_pose(given, POSE)
            sample = Sample(stamp, tool[:3], given.header.frame_id, topic, arrival, tool=tool)
        if self._active:
            self._transformer.add_point(sample)
        if self.time - self._ticked > TICK:
            self._ticked = self.time
            self._transformer.process(arrival)

    def array(self, T: Array, stamp: float) -> None:
        """Receive a pose (4, 4) of the reference array of time ``stamp``, s after `START`."""
        given = self._record(message(POSE, START + stamp, pose_body(T)), ARRAY)
        self._transformer.add_pose(
            stamps.to_seconds(given.header.stamp.sec, given.header.stamp.nanosec),
            to_matrix(given.pose.position, given.pose.orientation), 'tracker')

    def _record(self, given: Any, topic: str) -> Any:
        """Record a message; return it as it is read from the bag."""
        data = bytes(TYPES.serialize_cdr(given, given.__msgtype__))
        self.messages.append((self.time, topic, given.__msgtype__, data))
        stamp = given.header.stamp
        self._last[topic] = (self._last.get(topic, (0, 0.0))[0] + 1,
                             stamps.to_seconds(stamp.sec, stamp.nanosec))
        return TYPES.deserialize_cdr(data, given.__msgtype__)

    # what the operator does

    def call(self, name: str, **request: Any) -> Answer:
        """Carry out a request as the services of the node do."""
        if 'T_tracker_bone' in request:     # it comes as a message
            self._start = pose_body(np.array(request['T_tracker_bone']))
            request['T_tracker_bone'] = to_matrix(self._start.position,
                                                  self._start.orientation).tolist()
        event = self._begin(name, request)
        session, follow_up = self.session, ''
        if name == 'collect':
            answer = session.collect(request['data'])
        elif name in ('undo', 'drop_stroke'):
            answer, follow_up = self._drop(request.get('stroke'))
        elif name == 'register':
            T = request.get('T_tracker_bone')
            found = session.register(T_tracker_bone=None if T is None else np.array(T))
            answer = Answer(found.success, f'{found.reason}: {found.message}', found)
        elif name == 'clear':
            self._transformer.clear()
            answer = session.clear()
        elif name == 'parameters':
            session.configure(session.config.replaced(request))
            if 'probe.topics' in request:       # new subscriptions
                self._transformer.finish()
                self._transformer = PointTransformer(session, None)
            answer = Answer(True, '')
        elif name == 'initial_pose':
            answer = session.set_initial_pose(np.array(request['T_tracker_bone']),
                                              request['frame_id'])
        elif name in ('calibrate_tip', 'find_joint_centre'):
            answer = session.calibrations.call(CalibrationKind(name))
        else:       # with the time of the node
            does: Callable[[float], Answer] = getattr(session, name)
            answer = does(START + self.time)
        self._publish(event, answer, follow_up)
        self._introspect(event, answer)
        if name == 'calibrate_tip' and isinstance(answer.detail, FixedPoint) and answer.success:
            assert answer.detail.point is not None
            count = len(self.services)
            self.call('parameters', **{'probe.tip': answer.detail.point.tolist(),
                                       'probe.tip_error': answer.detail.rms_error})
            del self.services[count:]       # the node sets it without a service
        return answer

    def end_joint_search(self, meanwhile: Callable[[], None]) -> Answer:
        """End the search for a joint centre; the node goes on until the centre is found."""
        event = self._begin('find_joint_centre', {})
        solve = self.session.calibrations.begin_or_end(CalibrationKind.JOINT_CENTRE)
        assert not isinstance(solve, Answer)
        meanwhile()
        found = solve()
        self._publish(event, found)
        self._introspect(event, found)
        return found

    def _introspect(self, event: OperatorEvent, answer: Answer) -> None:
        """Record a request and its answer as service introspection does, or an initial pose."""
        topic, time = f'{NODE}/{event.name}', event.stamp - START + 0.5 * STEP
        if event.name == 'initial_pose':
            given = initial_pose_message(np.array(event.request['T_tracker_bone']),
                                         event.request['frame_id'])
            self.services.append((time, topic, INITIAL_POSE,
                                  bytes(TYPES.serialize_cdr(given, INITIAL_POSE))))
            return
        kind, request = 'std_srvs/srv/Trigger', [0]
        name, response = event.name, [answer.success, answer.message]
        if name == 'collect':
            kind, request = 'std_srvs/srv/SetBool', [event.request['data']]
        elif name == 'drop_stroke':
            kind, request = 'gsdf_registration_msgs/srv/DropStroke', [event.request['stroke']]
        elif name == 'register' and event.request:
            name, kind = f'typed/{name}', 'gsdf_registration_msgs/srv/Register'
            request = [True, message(POSE, 0.0, self._start, '')]
        elif name == 'parameters':
            name, kind = 'set_parameters_atomically', 'rcl_interfaces/srv/SetParametersAtomically'
            request = [[parameter(*each) for each in event.request.items()]]
            response = [parameter_result(True)]
        topic = f'{NODE}/{name}/_service_event'
        self.services += [
            (time, topic, f'{kind}_Event', service_event(
                kind, REQUEST_RECEIVED, event.number, [service_part(kind, 'Request', *request)])),
            (self.time + 0.5 * STEP, topic, f'{kind}_Event', service_event(
                kind, RESPONSE_SENT, event.number,
                response=[service_part(kind, 'Response', *response)]))]

    def change(self, name: str) -> None:
        """Configure, activate or deactivate the node."""
        if name == 'configure':     # with a new session and new subscriptions
            self.session = Session(self.session.config, self._field)
            self._transformer = PointTransformer(self.session, None)
        event = self._begin(name, self._state())
        if name != 'configure':
            getattr(self.session, name)()
        self._active = name == 'activate'
        self._publish(event, Answer(True, ''))
        during, after = {'configure': ('configuring', 'inactive'),
                         'activate': ('activating', 'active'),
                         'deactivate': ('deactivating', 'inactive')}[name]
        self.services += [
            (self.time + 0.5 * STEP, f'{NODE}/transition_event', TRANSITION, bytes(
                TYPES.serialize_cdr(transition_event(*states), TRANSITION)))
            for states in (('', during), (during, after))]

    def _state(self) -> dict[str, Any]:
        return {'settings': self.session.config.flat(), 'model_sha256': self._field.bone_sha256}

    def refuse(self, name: str, sentence: str = BUSY) -> None:
        """Refuse a request at once."""
        event, answer = self._begin(name, {}, performed=False), Answer(False, sentence)
        self._publish(event, answer)
        self._introspect(event, answer)

    def _drop(self, stroke: int | None) -> tuple[Answer, str]:
        session, before = self.session, self.session.status().outdated
        answer = session.undo() if stroke is None else session.drop_stroke(stroke)
        if not answer.success or before or not session.status().outdated:
            return answer, ''
        if session.register().success:
            return answer, 'registered'
        session.withdraw_pose(Withdrawal.POINTS_DROPPED, 'register again')
        return answer, 'refused'

    def _begin(self, name: str, request: Mapping[str, Any],
               performed: bool = True) -> OperatorEvent:
        self._number += 1
        return OperatorEvent(self._number, name, START + self.time, request=dict(request),
                             performed=performed, kept=self.session.kept, last=dict(self._last))

    def _publish(self, event: OperatorEvent, answer: Answer, follow_up: str = '') -> None:
        done = OperatorEvent(event.number, event.name, event.stamp, answer.success, answer.message,
                             event.request, event.performed, follow_up, event.kept, event.last)
        self.messages.append((self.time, EVENTS, STATUS, event_message(done)))

    def end(self) -> None:
        """Reject the samples that wait in vain for a pose of the array."""
        self._transformer.process(START + self.time + 10.0)

    def write(self, path: Path, delays: Mapping[str, float] | None = None,
              services: bool = False) -> None:
        """
        Write what a recorder that receives the topics with ``delays``, s, writes.

        ``services``: service introspection in place of the events of the node.
        """
        messages = self.messages if not services else self.services + [
            each for each in self.messages if each[1] != EVENTS]
        with BagWriter(path) as bag:
            for time, topic, kind, data in messages:
                if topic not in bag.counts:
                    bag.add_topic(topic, kind, 'not needed' if '/srv/' in kind else '')
                received = START + time + (delays or {}).get(topic, 0.0)
                bag.write(topic, stamps.to_nanoseconds(received), data)


def held(place: Array, samples: int = 50) -> Array:
    """Return positions (n, 3) of a tip that is held still."""
    return np.tile(place, (samples, 1))
