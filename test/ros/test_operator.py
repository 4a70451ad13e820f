# SPDX-License-Identifier: Apache-2.0
"""Services and topics of an active node, as seen by an operator and by displays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.parameter import Parameter
from ros_support import Client, NodeProcess, Tracker
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import exp, transform
from msg_adapters import ros

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
STILL = np.eye(4)
MOVED = exp([0.1, -0.3, 0.2, 0.05, 0.1, -0.04])


def register_at(tracker: Tracker, T_moved: np.ndarray) -> None:
    assert tracker.client.ask('clear').success
    tracker.touch_landmarks(T_moved)
    tracker.drag(T_moved)
    answer = tracker.client.ask('register')
    assert answer.success, answer.message


def latched_pose(node: NodeProcess) -> np.ndarray:
    """Return the pose that a late joiner receives."""
    with Client(node) as late_joiner:
        return ros.pose_from(late_joiner.receive(PoseStamped, '~/bone_pose'))[1]


def test_new_registration_replaces_the_pose_for_all_subscribers(
        tracker: Tracker, shared_node: NodeProcess) -> None:
    received: list[PoseStamped] = []
    client = tracker.client
    register_at(tracker, STILL)
    subscription = client.node.create_subscription(PoseStamped, '/registration/bone_pose',
                                                   received.append, 10)
    tracker.assert_near_truth(latched_pose(shared_node), STILL)
    register_at(tracker, MOVED)
    client.spin_until(lambda: bool(received), 'the subscriber does not receive the new pose')
    client.node.destroy_subscription(subscription)
    tracker.assert_near_truth(ros.pose_from(received[-1])[1], MOVED)
    tracker.assert_near_truth(latched_pose(shared_node), MOVED)


def test_refused_registration_keeps_the_accepted_one(
        tracker: Tracker, shared_node: NodeProcess) -> None:
    register_at(tracker, STILL)
    few = Config().limits.min_points
    assert tracker.client.set_parameters(Parameter('limits.min_points', value=10_000)) == ''
    answer = tracker.client.ask('register')
    assert tracker.client.set_parameters(Parameter('limits.min_points', value=few)) == ''
    assert not answer.success
    assert answer.message.startswith('too_few_points: ')
    assert 'accepted registration is kept' in answer.message
    status = tracker.client.status(state='refused', reason='too_few_points')
    assert status['pose'] == 'in tracker'
    assert 'accepted registration is kept' in status['message']
    tracker.assert_near_truth(latched_pose(shared_node), STILL)


def test_accepts_an_initial_pose_in_the_frame_of_the_points(tracker: Tracker,
                                                            shared_node: NodeProcess) -> None:
    client = tracker.client
    publisher = client.node.create_publisher(PoseWithCovarianceStamped,
                                             '/registration/initial_pose', 10)
    client.spin_until(publisher.get_subscription_count, 'nothing subscribes to ~/initial_pose')
    client.collect(True)
    tracker.send(tracker.positions[:5])
    client.status(frame_id='tracker')
    near = tracker.truth.T_tracker_bone
    guess = ros.pose_with_covariance_msg(near, np.zeros((6, 6)), 'map', Time())
    publisher.publish(guess)
    client.receive(DiagnosticStatus, '~/status', accept=lambda status: (
        status.level == DiagnosticStatus.WARN
        and 'the initial pose is rejected: it is in frame "map"' in status.message))
    guess.pose.pose.orientation.w += 1.0
    publisher.publish(guess)
    client.receive(DiagnosticStatus, '~/status', accept=lambda status: (
        status.level == DiagnosticStatus.WARN and 'unit length' in status.message))
    publisher.publish(ros.pose_with_covariance_msg(near, np.zeros((6, 6)), 'tracker', Time()))
    client.spin_until(lambda: 'the initial pose is the first guess' in shared_node.log,
                      'the initial pose is not accepted')
    client.node.destroy_publisher(publisher)


def test_rejects_and_counts_points_in_another_frame(tracker: Tracker) -> None:
    tracker.client.collect(True)
    tracker.send(tracker.positions[:5])
    tracker.send(tracker.positions[:7], topic='/probe/second', frame_id='elsewhere')
    status = tracker.client.status(rejected__wrong_frame='7')
    assert status['kept'] == '5'
    assert status['frame_id'] == 'tracker'


def test_collects_strokes_and_undoes_them(tracker: Tracker) -> None:
    client = tracker.client
    for first, last, stroke in ((0, 10, '1'), (10, 30, '2')):
        assert client.collect(True).success
        tracker.send(tracker.positions[first:last])
        # else the last points may belong to the next stroke
        client.status(kept=str(last), strokes=stroke)
    client.collect(False)
    tracker.send(tracker.positions[30:35])
    client.status(rejected__not_collecting='5')
    assert client.ask('undo').success
    client.status(kept='10', strokes='1')
    assert client.ask('undo').success
    answer = client.ask('undo')
    assert not answer.success
    assert 'no stroke' in answer.message


def test_does_not_capture_a_landmark_with_a_moving_tip(tracker: Tracker) -> None:
    path = iter(np.outer(np.linspace(0.0, 10.0, 6000), [1.0, 0.0, 0.0]).reshape(-1, 60, 3))

    def moves() -> bool:
        tracker.send(next(path))
        answer = tracker.client.ask('capture_landmark')
        assert not answer.success
        return 'moves' in answer.message
    tracker.client.spin_until(moves, 'the motion of the tip is not reported')


def test_verifies_a_touched_point(tracker: Tracker) -> None:
    register_at(tracker, STILL)
    outside = transform(tracker.truth.T_tracker_bone, np.array([0.0, 0.0, 0.5]))
    tracker.send(np.tile(outside, (60, 1)))
    # until the last samples are received
    tracker.client.spin_until(lambda: 'moves' not in tracker.client.ask('verify').message,
                              'the tip is not stationary')
    answer = tracker.client.ask('verify')
    assert not answer.success
    assert 'outside' in answer.message


def test_reports_a_displaced_array_at_a_checkpoint(tracker: Tracker) -> None:
    register_at(tracker, STILL)
    client = tracker.client
    client.collect(True)        # points of a verification are not collected
    before = client.status()
    rng = np.random.default_rng(0)
    side = 0.001 * tracker.truth.T_tracker_bone[:3, 0]
    lifted, sent, verdicts = 0, 0, []
    for shift, expected in ((0.0, 'touch it again later'), (0.4, 'checkpoint 1 moved 0.4 mm'),
                            (3.4, 'checkpoint 1 moved 3.4 mm')):
        tracker.send(tracker.positions[50] + 0.002 * np.arange(10, 20)[:, None], 0.1)    # lifted
        lifted += 10
        answer = client.ask('verify')
        while expected not in answer.message:       # until the samples are received
            noise = rng.normal(0.0, 5e-5, (60, 3))
            tracker.send(tracker.positions[50] + shift * side + noise,
                         np.r_[0.1, np.full(59, 0.0125)])
            sent += 60
            answer = client.ask('verify')
        verdicts.append(answer.success)
    assert verdicts == [True, True, False]
    assert answer.message.endswith('was the array displaced? The pose is withdrawn')
    status = client.status(pose='none', withdrawn='array_displaced')
    assert 'clear and collect again' in status['message']
    client.status(kept=str(int(before['kept']) + lifted),
                  rejected__touched=str(int(before['rejected.touched']) + sent))


def test_loads_a_session_that_another_node_saved(tracker: Tracker, shared_node: NodeProcess,
                                                       parameters: dict[str,
                                                                        Any], shared_session: Path,
                                                       start_node: StartNode) -> None:
    register_at(tracker, STILL)
    before = tracker.client.status(state='registered')
    assert tracker.client.ask('save').success
    second = start_node('second', **parameters, **{'session.path': shared_session})
    with Client(second) as client:
        client.await_state('active')
        answer = client.ask('load')
        assert answer.success, answer.message
        after = client.status(state='registered')
        tracker.assert_near_truth(latched_pose(second), STILL)
        assert client.ask('register').success       # with the loaded points
    for key in ('kept', 'strokes', 'landmarks', 'frame_id', 'predicted_tre_m.rms'):
        assert after[key] == before[key]


def test_rejects_a_damaged_session(tracker: Tracker, shared_session: Path) -> None:
    client = tracker.client
    client.collect(True)
    tracker.send(tracker.positions[:9], tracker.steps[:9])
    kept = client.status(received='9')['kept']
    client.collect(False)
    answer = client.ask('save')
    assert answer.success
    assert answer.message.startswith(f'session with {kept} points saved to {shared_session}')
    saved = shared_session.read_text()
    shared_session.write_text(saved.replace('"stroke", "source"', '"source", "stroke"'))
    answer = client.ask('load')
    assert not answer.success
    assert 'is damaged: its content does not fit its checksum' in answer.message
    shared_session.write_text('targets: {}')
    assert 'is no session file, so it is not overwritten' in client.ask('save').message
    assert shared_session.read_text() == 'targets: {}'
    shared_session.unlink()


@pytest.mark.usefixtures('many_points')
def test_answers_a_second_registration_at_once_while_one_runs(tracker: Tracker) -> None:
    client = tracker.client
    assert client.ask('load').success
    received = int(client.status()['received'])
    order: list[str] = []
    requests = []
    for name in ('first', 'second'):
        requests.append(client.start(Trigger, 'register', Trigger.Request()))
        requests[-1].add_done_callback(lambda _, name=name: order.append(name))
    tracker.send(tracker.positions[:20])
    first, second = (client.result(request) for request in requests)
    client.spin_until(lambda: len(order) == 2, 'a request is not answered')
    assert order == ['second', 'first']
    assert not second.success
    assert 'wait' in second.message
    assert first.success, first.message
    client.status(received=str(received + 20))      # points were received meanwhile


def test_publishes_the_points_in_the_bone_frame(tracker: Tracker, shared_node: NodeProcess) -> None:
    # the live registration would draw its own weights over those of the registration
    live = Parameter('live.enabled', Parameter.Type.BOOL, False)
    assert tracker.client.set_parameters(live) == ''
    try:
        register_at(tracker, STILL)
        with Client(shared_node) as display:
            cloud = display.receive(PointCloud2, '~/points')
            bone = display.receive(MarkerArray, '~/markers')
            status = display.status(state='registered')
    finally:
        assert tracker.client.set_parameters(
            Parameter('live.enabled', Parameter.Type.BOOL, True)) == ''
    assert cloud.header.frame_id == 'bone'
    columns = ros.cloud_to_arrays(cloud)
    assert list(columns) == ['x', 'y', 'z', 'residual', 'weight', 'stroke']
    assert len(columns['x']) == int(status['kept'])
    good = columns['weight'] > 0.5
    assert np.abs(columns['residual'][good]).max() < 1e-3
    assert good.sum() == int(status['inliers'])
    assert {marker.header.frame_id for marker in bone.markers} == {'bone'}
    surface = np.array([[p.x, p.y, p.z] for p in bone.markers[0].points])
    assert 0.1 < np.ptp(surface, axis=0).max() < 0.3     # metres


def test_publishes_diagnostics_every_second(client: Client) -> None:
    array = client.receive(DiagnosticArray, '/diagnostics', 10)
    assert array.status[0].name.startswith('/registration')
    assert array.header.stamp.sec > 0


def test_repeats_the_transform(tracker: Tracker) -> None:
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        pytest.skip('tf2_msgs is neither installed nor built, see tools/build_messages.py')
    register_at(tracker, MOVED)
    first = tracker.client.receive(TFMessage, '/tf', 10).transforms[0]
    later = tracker.client.receive(
        TFMessage, '/tf', 10,
        lambda message: message.transforms[0].header.stamp != first.header.stamp)
    _, T, parent, child = ros.transform_from(later.transforms[0])
    assert (parent, child) == ('tracker', 'bone')
    tracker.assert_near_truth(T, MOVED)
