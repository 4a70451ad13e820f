# SPDX-License-Identifier: Apache-2.0
"""The services and topics of an active node, as an operator and his screens see them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from ros_support import Client, NodeProcess, Tracker
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from gsdf_registration.common.rigid import exp
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
    """Return the pose as one who joins only now receives it."""
    with Client(node) as late_joiner:
        return ros.pose_from(late_joiner.receive(PoseStamped, '~/bone_pose'))[1]


def test_a_new_registration_replaces_the_pose_for_everyone(
        tracker: Tracker, shared_node: NodeProcess) -> None:
    heard: list[PoseStamped] = []
    client = tracker.client
    register_at(tracker, STILL)
    subscription = client.node.create_subscription(PoseStamped, '/registration/bone_pose',
                                                   heard.append, 10)
    tracker.assert_near_truth(latched_pose(shared_node), STILL)
    register_at(tracker, MOVED)
    client.spin_until(lambda: bool(heard), 'the one who listened before did not hear the new pose')
    client.node.destroy_subscription(subscription)
    tracker.assert_near_truth(ros.pose_from(heard[-1])[1], MOVED)
    tracker.assert_near_truth(latched_pose(shared_node), MOVED)


def test_a_refused_registration_leaves_the_last_good_pose_and_says_so(
        tracker: Tracker, shared_node: NodeProcess) -> None:
    register_at(tracker, STILL)
    tracker.client.ask('clear')
    answer = tracker.client.ask('register')
    assert not answer.success
    assert answer.message.startswith('too_few_points: ')
    assert 'last good pose' in answer.message
    status = tracker.client.status(state='refused', reason='too_few_points')
    assert status['pose'] == 'in tracker'
    assert 'last good pose' in status['message']
    tracker.assert_near_truth(latched_pose(shared_node), STILL)


def test_points_of_another_frame_are_refused_and_counted(tracker: Tracker) -> None:
    tracker.client.collect(True)
    tracker.send(tracker.positions[:5])
    tracker.send(tracker.positions[:7], topic='/probe/second', frame_id='elsewhere')
    status = tracker.client.status(rejected__wrong_frame='7')
    assert status['kept'] == '5'
    assert status['frame_id'] == 'tracker'


def test_strokes_are_collected_and_undone(tracker: Tracker) -> None:
    client = tracker.client
    for first, last, stroke in ((0, 10, '1'), (10, 30, '2')):
        assert client.collect(True).success
        tracker.send(tracker.positions[first:last])
        client.status(kept=str(last), strokes=stroke)   # or the last ones may fall in the next
    client.collect(False)
    tracker.send(tracker.positions[30:35])
    client.status(rejected__not_collecting='5')
    assert client.ask('undo').success
    client.status(kept='10', strokes='1')
    assert client.ask('undo').success
    answer = client.ask('undo')
    assert not answer.success
    assert 'no stroke' in answer.message


def test_a_landmark_is_not_captured_from_a_moving_tip(tracker: Tracker) -> None:
    path = iter(np.outer(np.linspace(0.0, 10.0, 6000), [1.0, 0.0, 0.0]).reshape(-1, 60, 3))

    def moves() -> bool:
        tracker.send(next(path))
        answer = tracker.client.ask('capture_landmark')
        assert not answer.success
        return 'moves' in answer.message
    tracker.client.spin_until(moves, 'it was not told that the tip moves')


def test_a_touched_point_is_verified(tracker: Tracker) -> None:
    register_at(tracker, STILL)
    off = tracker.truth.T_tracker_bone[:3, :3] @ [0.0, 0.0, 0.5] + tracker.truth.T_tracker_bone[:3,
                                                                                                3]
    tracker.send(np.tile(off, (60, 1)))
    # until its last moments have come in
    tracker.client.spin_until(lambda: 'moves' not in tracker.client.ask('verify').message,
                              'the tip does not rest')
    answer = tracker.client.ask('verify')
    assert not answer.success
    assert 'outside' in answer.message


def test_a_checkpoint_touched_again_tells_that_the_array_was_bumped(tracker: Tracker) -> None:
    register_at(tracker, STILL)
    client = tracker.client
    client.collect(True)        # a verification is kept out of what is being collected
    before = client.status()
    rng = np.random.default_rng(0)
    side = 0.001 * tracker.truth.T_tracker_bone[:3, 0]
    lifted, sent, verdicts = 0, 0, []
    for shift, expected in ((0.0, 'touch it again later'), (0.4, 'checkpoint 1 moved 0.4 mm'),
                            (3.4, 'checkpoint 1 moved 3.4 mm')):
        tracker.send(tracker.positions[50] + 0.002 * np.arange(10, 20)[:, None], 0.1)    # lifted
        lifted += 10
        answer = client.ask('verify')
        while expected not in answer.message:       # until the samples have come through
            noise = rng.normal(0.0, 5e-5, (60, 3))
            tracker.send(tracker.positions[50] + shift * side + noise,
                         np.r_[0.1, np.full(59, 0.0125)])
            sent += 60
            answer = client.ask('verify')
        verdicts.append(answer.success)
    assert verdicts == [True, True, False]
    assert answer.message.endswith('was the array bumped?')
    client.status(kept=str(int(before['kept']) + lifted),
                  rejected__touched=str(int(before['rejected.touched']) + sent))


def test_a_session_is_saved_and_loaded_by_another_node(tracker: Tracker, shared_node: NodeProcess,
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
        assert client.ask('register').success       # on the points loaded
    for key in ('kept', 'strokes', 'landmarks', 'frame_id', 'predicted_tre_m.rms'):
        assert after[key] == before[key]


def test_a_damaged_session_is_refused(tracker: Tracker, shared_session: Path) -> None:
    shared_session.write_text('{"schema": ')
    answer = tracker.client.ask('load')
    assert not answer.success
    assert 'damaged' in answer.message


@pytest.mark.usefixtures('many_points')
def test_a_second_registration_is_answered_at_once_while_one_runs(tracker: Tracker) -> None:
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
    client.spin_until(lambda: len(order) == 2, 'not both were heard of')
    assert order == ['second', 'first']
    assert not second.success
    assert 'wait' in second.message
    assert first.success, first.message
    client.status(received=str(received + 20))      # points came in meanwhile


def test_the_points_are_shown_in_the_bone_frame(tracker: Tracker, shared_node: NodeProcess) -> None:
    register_at(tracker, STILL)
    with Client(shared_node) as screen:
        cloud = screen.receive(PointCloud2, '~/points')
        bone = screen.receive(MarkerArray, '~/markers')
        status = screen.status(state='registered')
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


def test_diagnostics_come_every_second(client: Client) -> None:
    array = client.receive(DiagnosticArray, '/diagnostics', 10)
    assert array.status[0].name.startswith('/registration')
    assert array.header.stamp.sec > 0


def test_the_transform_is_resent(tracker: Tracker) -> None:
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
