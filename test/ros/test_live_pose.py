# SPDX-License-Identifier: Apache-2.0
"""The live pose of a node and its status while points arrive."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped
from rclpy.qos import QoSProfile
from ros_support import Client, Tracker, values

from gsdf_registration.clients.operator import LATCHED
from gsdf_registration.common.rigid import (
    Array,
    from_rt,
    inverse,
    rotation_from_quaternion,
    transform,
)
from msg_adapters import ros

pytestmark = pytest.mark.ros
ENOUGH = 300    # points of the recording


class Display:
    """Receives all messages of the node and of the probe, in order."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.poses: list[PoseWithCovarianceStamped] = []
        self.statuses: list[DiagnosticStatus] = []
        self.stamps: set[tuple[int, int]] = set()
        node, deep = client.node, QoSProfile(depth=10_000)
        self._subscriptions = [
            node.create_subscription(PoseWithCovarianceStamped, '/registration/live_pose',
                                     self.poses.append, deep),
            node.create_subscription(DiagnosticStatus, '/registration/status',
                                     self.statuses.append, LATCHED),
            node.create_subscription(PointStamped, '/probe/tip',
                                     lambda point: self.stamps.add(stamp_of(point)), deep)]

    def close(self) -> None:
        for subscription in self._subscriptions:
            self._client.node.destroy_subscription(subscription)


@pytest.fixture
def display(client: Client) -> Iterator[Display]:
    display = Display(client)
    yield display
    display.close()


def stamp_of(message: PointStamped | PoseStamped) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec


def pose_of(message: PoseWithCovarianceStamped) -> Array:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return from_rt(rotation_from_quaternion([q.x, q.y, q.z, q.w]), [p.x, p.y, p.z])


def send(tracker: Tracker, positions: Array, begin: int = 0) -> None:
    """Drag a stroke with the timing of the recording from row ``begin`` on."""
    assert tracker.client.collect(True).success
    tracker.send(positions, tracker.steps[begin:begin + len(positions)])


def test_live_pose_agrees_with_a_registration(tracker: Tracker,
                                                                       display: Display) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    status = client.status(received=str(ENOUGH), state='ready')
    assert status['message'].startswith('enough points: register now; expected error ')
    assert 0.0 < float(status['live.predicted_tre_m.rms']) < 1e-3
    assert int(status['live.points']) > 200 and status['live.reason'] == ''
    tracker.send(tracker.positions[ENOUGH:ENOUGH + 100], tracker.steps[ENOUGH:ENOUGH + 100])
    client.spin_until(lambda: len(display.poses) > 5, 'there are only a few live poses')
    client.spin_until(lambda: {stamp_of(pose) for pose in display.poses} <= display.stamps,
                      'a live pose does not have the stamp of a point')
    assert display.poses[-1].header.frame_id == 'tracker'
    live = pose_of(display.poses[-1])
    covariance = np.reshape(display.poses[-1].pose.covariance, (6, 6))
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    tracker.assert_near_truth(live, np.eye(4))
    assert client.ask('register').success
    registered = client.receive(PoseWithCovarianceStamped, '~/bone_pose_with_covariance')
    # both have the stamp of the newest point
    client.spin_until(lambda: stamp_of(display.poses[-1]) == stamp_of(registered),
                      'the stamps of the live and of the registered pose differ')
    apart = transform(inverse(live) @ pose_of(registered), tracker.truth.landmarks_model)
    np.testing.assert_allclose(apart, tracker.truth.landmarks_model, atol=5e-4)
    states = [values(status)['state'] for status in display.statuses]
    assert [a for a, b in zip(states, states[1:]) if a != 'ready' and b == 'ready'] == [
        'collecting']


def test_status_names_where_to_touch_next(tracker: Tracker,
                                                           display: Display) -> None:
    send(tracker, tracker.positions[:90])
    tracker.client.spin_until(
        lambda: any(values(status).get('touch_next') for status in display.statuses),
        'no place to touch is named')
    status = next(status for status in display.statuses if values(status).get('touch_next'))
    known = values(status)
    assert known['live.reason'] in ('ambiguous', 'under_constrained')
    assert known['touch_next'].startswith('touch the bone ')
    assert known['touch_next'] in status.message and known['state'] == 'collecting'


def circle(place: Array) -> Array:
    """Return a short stroke (100, 3) around a place, at the speed of a hand."""
    turn = np.linspace(0.0, 4.0 * np.pi, 100)
    return place + 0.004 * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])


def test_live_pose_follows_an_undo_and_ends_with_a_clear(tracker: Tracker,
                                                         display: Display) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    client.status(received=str(ENOUGH), state='ready')
    last = ros.seconds_to_stamp(tracker._stamp)
    newest = last.sec, last.nanosec
    assert client.collect(True).success
    tracker.send(circle(tracker.positions[50] + [0.0, 0.0, 0.003]))
    client.status(received=str(ENOUGH + 100))
    client.spin_until(lambda: stamp_of(display.poses[-1]) > newest, 'the pose does not change')
    assert client.ask('undo').success
    # no new points: the undo alone changes the pose
    client.spin_until(lambda: stamp_of(display.poses[-1]) <= newest, 'the pose does not change')
    tracker.assert_near_truth(pose_of(display.poses[-1]), np.eye(4))
    client.status(state='ready')
    assert client.ask('clear').success
    status = client.status(live__points='0')
    assert status['state'] != 'ready' and 'live.predicted_tre_m.rms' not in status


def test_registers_again_after_an_undo(
        tracker: Tracker, display: Display) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    assert client.collect(True).success
    tracker.send(circle(tracker.positions[50]))
    client.status(received=str(ENOUGH + 100))
    assert client.ask('register').success
    before = client.receive(PoseStamped, '~/bone_pose')
    answer = client.ask('undo')
    assert answer.success
    assert 'registered again without it: the bone moved by 0.' in answer.message
    # the newest point that it uses is an earlier one
    client.receive(PoseStamped, '~/bone_pose',
                   accept=lambda pose: stamp_of(pose) < stamp_of(before))
    client.status(state='registered')


def test_reports_a_stroke_of_interference(tracker: Tracker) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    client.status(state='ready')
    assert client.collect(True).success
    tracker.send(circle(tracker.positions[50] + tracker.truth.T_tracker_bone[:3, 2] * 0.08))
    client.spin_until(
        lambda: any('interference' in value for key, value in client.status().items()
                    if key.startswith('stroke.')), 'no stroke is reported as interference')
