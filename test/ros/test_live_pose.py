# SPDX-License-Identifier: Apache-2.0
"""The pose that a node keeps up while points come in, and what it tells the operator meanwhile."""

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


class Screen:
    """What a client hears of the node and of the probe, all of it, in order."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.poses: list[PoseWithCovarianceStamped] = []
        self.statuses: list[DiagnosticStatus] = []
        self.stamps: set[tuple[int, int]] = set()
        node, deep = client.node, QoSProfile(depth=10_000)
        self._heard = [
            node.create_subscription(PoseWithCovarianceStamped, '/registration/live_pose',
                                     self.poses.append, deep),
            node.create_subscription(DiagnosticStatus, '/registration/status',
                                     self.statuses.append, LATCHED),
            node.create_subscription(PointStamped, '/probe/tip',
                                     lambda point: self.stamps.add(stamp_of(point)), deep)]

    def close(self) -> None:
        for subscription in self._heard:
            self._client.node.destroy_subscription(subscription)


@pytest.fixture
def screen(client: Client) -> Iterator[Screen]:
    screen = Screen(client)
    yield screen
    screen.close()


def stamp_of(message: PointStamped | PoseStamped) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec


def pose_of(message: PoseWithCovarianceStamped) -> Array:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return from_rt(rotation_from_quaternion([q.x, q.y, q.z, q.w]), [p.x, p.y, p.z])


def send(tracker: Tracker, positions: Array, begin: int = 0) -> None:
    """Drag a stroke whose rows take the time of those recorded from ``begin`` on."""
    assert tracker.client.collect(True).success
    tracker.send(positions, tracker.steps[begin:begin + len(positions)])


def test_a_pose_comes_with_the_points_and_is_what_a_registration_finds(tracker: Tracker,
                                                                       screen: Screen) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    status = client.status(received=str(ENOUGH), state='ready')
    assert status['message'].startswith('enough: register now; expected error 0.')
    assert 0.0 < float(status['live.predicted_tre_m.rms']) < 1e-3
    assert int(status['live.points']) > 200 and status['live.reason'] == ''
    tracker.send(tracker.positions[ENOUGH:ENOUGH + 100], tracker.steps[ENOUGH:ENOUGH + 100])
    client.spin_until(lambda: len(screen.poses) > 5, 'few live poses were heard')
    client.spin_until(lambda: {stamp_of(pose) for pose in screen.poses} <= screen.stamps,
                      'a live pose has the stamp of no point')
    assert screen.poses[-1].header.frame_id == 'tracker'
    live = pose_of(screen.poses[-1])
    covariance = np.reshape(screen.poses[-1].pose.covariance, (6, 6))
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    tracker.assert_near_truth(live, np.eye(4))
    assert client.ask('register').success
    registered = client.hear(PoseWithCovarianceStamped, '~/bone_pose_with_covariance')
    apart = transform(inverse(live) @ pose_of(registered), tracker.truth.landmarks_model)
    np.testing.assert_allclose(apart, tracker.truth.landmarks_model, atol=5e-4)
    states = [values(status)['state'] for status in screen.statuses]
    assert [a for a, b in zip(states, states[1:]) if a != 'ready' and b == 'ready'] == [
        'collecting']


def test_the_status_says_where_to_touch_until_it_is_enough(tracker: Tracker,
                                                           screen: Screen) -> None:
    send(tracker, tracker.positions[:90])
    tracker.client.spin_until(
        lambda: any(values(status).get('touch_next') for status in screen.statuses),
        'it was never said where to touch')
    told = next(status for status in screen.statuses if values(status).get('touch_next'))
    known = values(told)
    assert known['live.reason'] in ('ambiguous', 'under_constrained')
    assert known['touch_next'].startswith('touch the bone ')
    assert known['touch_next'] in told.message and known['state'] == 'collecting'


def rub(place: Array) -> Array:
    """Return a short stroke (100, 3) round a place, as slow as a hand."""
    turn = np.linspace(0.0, 4.0 * np.pi, 100)
    return place + 0.004 * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])


def test_the_pose_follows_an_undo_and_goes_with_a_clear(tracker: Tracker, screen: Screen) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    client.status(received=str(ENOUGH), state='ready')
    last = ros.seconds_to_stamp(tracker._stamp)
    newest = last.sec, last.nanosec
    assert client.collect(True).success
    tracker.send(rub(tracker.positions[50] + [0.0, 0.0, 0.003]))
    client.status(received=str(ENOUGH + 100))
    client.spin_until(lambda: stamp_of(screen.poses[-1]) > newest, 'the pose stood still')
    assert client.ask('undo').success
    # no point has come in since: it follows the undo itself
    client.spin_until(lambda: stamp_of(screen.poses[-1]) <= newest, 'the pose does not follow')
    tracker.assert_near_truth(pose_of(screen.poses[-1]), np.eye(4))
    client.status(state='ready')
    assert client.ask('clear').success
    status = client.status(live__points='0')
    assert status['state'] != 'ready' and 'live.predicted_tre_m.rms' not in status


def test_a_registration_found_with_a_stroke_that_is_undone_is_found_anew(
        tracker: Tracker, screen: Screen) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    assert client.collect(True).success
    tracker.send(rub(tracker.positions[50]))
    client.status(received=str(ENOUGH + 100))
    assert client.ask('register').success
    before = client.hear(PoseStamped, '~/bone_pose')
    answer = client.ask('undo')
    assert answer.success
    assert 'registered anew without it: the bone moved by 0.' in answer.message
    client.hear(PoseStamped, '~/bone_pose', accept=lambda pose: stamp_of(pose) > stamp_of(before))
    client.status(state='registered')


def test_a_stroke_that_is_all_interference_is_named(tracker: Tracker) -> None:
    client = tracker.client
    send(tracker, tracker.positions[:ENOUGH])
    client.status(state='ready')
    assert client.collect(True).success
    tracker.send(rub(tracker.positions[50] + tracker.truth.T_tracker_bone[:3, 2] * 0.08))
    client.spin_until(
        lambda: any('interference' in value for key, value in client.status().items()
                    if key.startswith('stroke.')), 'no stroke was called interference')
