# SPDX-License-Identifier: Apache-2.0
"""A moving reference array, frames connected by /tf, and clocks that go back, over real DDS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_support import Client, NodeProcess, Tracker
from rosgraph_msgs.msg import Clock

from gsdf_registration.common.rigid import exp, inverse, transform
from gsdf_registration.node.transforms import STATIC
from gsdf_registration.simulation.moving import Sway
from msg_adapters import ros

pytestmark = pytest.mark.ros
ARRAY = '/array/pose'
NEW_SESSION = 'a new session was started'
RATE = 80.0         # Hz
STILL = np.eye(4)
# the array beside the bone; it moves at 20 mm/s and rotates at 10 degrees/s
T_TRACKER_ARRAY = exp([0.3, -0.2, 0.5, 0.0, 0.0, 0.0])


class MovingTracker(Tracker):
    """
    Publishes tip positions together with the motion of a body, at `RATE`.

    Positions are given as if nothing moved.
    """

    def __init__(self, client: Client, topics: list[str], frame_id: str, motion: Any,
                 message_at: Callable[[float], Any], place: Callable[[float, Any], Any]) -> None:
        super().__init__(client, topics)
        self.hidden = False
        self._frame_id, self._motion = frame_id, motion
        self._message_at, self._place = message_at, place
        self._next = self._stamp - 0.5

    def send(self, positions: np.ndarray, steps: np.ndarray | float = 1.0 / RATE,
             topic: str = '/probe/tip', frame_id: str = '') -> None:
        for position, step in zip(positions, np.broadcast_to(steps, len(positions))):
            self.publish_motion_until(self._stamp + float(step))
            super().send(self._place(self._stamp + float(step), position)[None], step, topic,
                         self._frame_id)
        self.publish_motion_until(self._stamp + 2.0 / RATE)

    def publish_motion_until(self, stamp: float) -> None:
        while self._next < stamp:
            if not self.hidden:
                self._motion.publish(self._message_at(self._next))
                time.sleep(0.0005)
            # skip the motion between strokes: everything is sent faster than real time
            self._next = max(self._next + 1.0 / RATE, stamp - 0.1)

    def restart(self) -> None:
        """Start again with the first stamp, like a looped recording."""
        self._stamp = 1000.0
        self._next = self._stamp - 0.004


def reliable(client: Client, kind: Any, topic: str) -> Any:
    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
    publisher = client.node.create_publisher(kind, topic, qos)
    client.spin_until(publisher.get_subscription_count, f'{topic} has no subscription')
    return publisher


@pytest.fixture(scope='module')
def node(parameters: dict[str, Any],
         tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    node = NodeProcess(tmp_path_factory.mktemp('moving') / 'log', 'moving',
                       **{**parameters, 'reference.topic': ARRAY})
    yield node
    node.stop()


def tracker_of_array(client: Client, sway: Sway) -> MovingTracker:
    def message_at(stamp: float) -> PoseStamped:
        return ros.pose_msg(sway.pose(stamp), 'tracker', ros.seconds_to_stamp(stamp))

    def place(stamp: float, position: np.ndarray) -> np.ndarray:
        return transform(sway.pose(stamp) @ inverse(sway.T_tracker_body), position)
    return MovingTracker(client, ['/probe/tip', '/probe/second'], 'tracker',
                         reliable(client, PoseStamped, ARRAY), message_at, place)


@pytest.fixture(scope='module')
def moving(node: NodeProcess) -> Iterator[MovingTracker]:
    with Client(node) as client:
        client.await_state('active')
        bone = Tracker(client, []).truth.T_tracker_bone
        tracker = tracker_of_array(client, Sway(bone @ T_TRACKER_ARRAY))
        tracker.await_listener()
        yield tracker


@pytest.fixture
def tracker_of_moving(moving: MovingTracker) -> MovingTracker:
    moving.hidden = False
    assert moving.client.ask('clear').success
    return moving


def register(tracker: MovingTracker) -> tuple[np.ndarray, str]:
    """Capture landmarks, drag, register; return the pose and its frame."""
    tracker.touch_landmarks(STILL)
    tracker.drag(STILL)
    answer = tracker.client.ask('register')
    assert answer.success, answer.message
    _, T, frame_id = ros.pose_from(tracker.client.receive(PoseStamped, '~/bone_pose'))
    return T, frame_id


def test_registers_a_moving_bone_like_a_stationary_one(node: NodeProcess,
                                                       tracker_of_moving: MovingTracker) -> None:
    tracker = tracker_of_moving
    client, sway = tracker.client, Sway(tracker.truth.T_tracker_bone @ T_TRACKER_ARRAY)
    T_moving, frame_id = register(tracker)
    assert frame_id == 'moving_reference_array'
    tracker.assert_near_truth(sway.T_tracker_body @ T_moving, STILL)

    on_bone = tracker.positions[300]
    for place, verdict in ((on_bone, 'within'), (on_bone + [0.0, 0.0, 0.02], 'beyond')):
        tracker.send(np.tile(place, (60, 1)))
        client.spin_until(lambda verdict=verdict: verdict in client.ask('verify').message,
                          f'the tip is not {verdict} the limit')

    still = tracker_of_array(client, Sway(sway.T_tracker_body, speed=0.0, turn=0.0, radius=1.0,
                                          tilt=1e-9))
    still._stamp = tracker._stamp + 1.0
    still._next = still._stamp
    client.ask('clear')
    T_still, _ = register(still)
    tracker._stamp = tracker._next = still._stamp + 1.0
    places = tracker.truth.landmarks_model
    difference = transform(T_moving, places) - transform(T_still, places)
    assert np.linalg.norm(difference, axis=1).max() < 1e-4


def test_counts_points_while_the_array_is_not_in_view(tracker_of_moving: MovingTracker) -> None:
    tracker, client = tracker_of_moving, tracker_of_moving.client
    client.collect(True)
    tracker.send(tracker.positions[:20])
    client.status(kept='20')
    tracker.hidden = True
    tracker._stamp = tracker._next      # beyond the last pose
    tracker.send(tracker.positions[20:50])
    status = client.status(rejected__no_reference='30', kept='20')
    assert ARRAY in status['message'] and 'in view' in status['message']
    tracker._stamp += 1.0
    tracker._next = tracker._stamp
    tracker.hidden = False
    tracker.send(tracker.positions[50:70])
    status = client.status(rejected__no_reference='30', kept='40')
    assert ARRAY not in status['message']


def test_looped_recording_starts_one_session_per_loop(node: NodeProcess,
                                               tracker_of_moving: MovingTracker) -> None:
    tracker, client = tracker_of_moving, tracker_of_moving.client
    before = node.log.count(NEW_SESSION)
    client.collect(True)
    for round_ in range(3):
        for first in range(0, 100, 10):     # small enough for the queues of a busy machine
            for topic in ('/probe/tip', '/probe/second'):
                tracker.send(tracker.positions[first:first + 10], topic=topic)
        status = client.status(received='200', rejected__no_reference='0',
                               rejected__not_monotonic='0')
        assert node.log.count(NEW_SESSION) == before + round_
        assert (NEW_SESSION in status['message']) == (round_ > 0)
        tracker.restart()
    tracker._stamp = tracker._next = 2000.0
    client.ask('clear')
    assert NEW_SESSION not in client.status(kept='0')['message']


def test_accepts_points_of_a_frame_connected_by_tf(tracker: Tracker) -> None:
    """The camera moves in the world, the bone does not; points are in the camera frame."""
    messages = pytest.importorskip('tf2_msgs.msg', reason='tf2_msgs is not installed')
    client, sway = tracker.client, Sway(exp([0.1, 0.2, 0.0, 0.3, 0.0, 0.2]))
    T_world_stand = exp([0.0, 0.5, 0.0, 0.1, 0.2, 0.3])
    assert client.set_parameters(Parameter('probe.frame_id', value='world')) == ''
    try:
        static = client.node.create_publisher(messages.TFMessage, '/tf_static', STATIC)
        static.publish(messages.TFMessage(transforms=[
            ros.transform_msg(T_world_stand, 'world', 'stand', ros.seconds_to_stamp(0.0))]))

        def message_at(stamp: float) -> Any:
            return messages.TFMessage(transforms=[ros.transform_msg(
                inverse(T_world_stand) @ sway.pose(stamp), 'stand', 'camera',
                ros.seconds_to_stamp(stamp))])

        def place(stamp: float, position: np.ndarray) -> np.ndarray:
            return transform(inverse(sway.pose(stamp)), position)
        camera = MovingTracker(client, ['/probe/tip'], 'camera',
                               reliable(client, messages.TFMessage, '/tf'), message_at, place)
        camera._stamp = camera._next = tracker._stamp + 100.0
        camera.await_listener()
        T, frame_id = register(camera)
        assert frame_id == 'world'
        camera.assert_near_truth(T, STILL)
        tracker._stamp = camera._stamp + 1.0
        tracker.send(tracker.positions[:5], frame_id='nowhere')
        status = client.status(rejected__wrong_frame='5')
        assert '"nowhere"' in status['message'] and '/tf' in status['message']
    finally:
        client.ask('clear')
        assert client.set_parameters(Parameter('probe.frame_id', value='')) == ''


def test_simulated_clock_that_goes_back_starts_one_session(start_node: Any) -> None:
    node = start_node('simulated', use_sim_time='true')
    with Client(node) as client:
        client.await_state('active')
        clock = reliable(client, Clock, '/clock')
        tracker = Tracker(client, ['/probe/tip'])

        def play(first: float, positions: np.ndarray) -> None:
            tracker._stamp = first
            for position in positions:
                clock.publish(Clock(clock=ros.seconds_to_stamp(tracker._stamp)))
                tracker.send(position[None], 0.02)

        def received() -> int:
            # the timers of the node, and so its status, use the simulated clock
            tracker._stamp += 0.5
            clock.publish(Clock(clock=ros.seconds_to_stamp(tracker._stamp)))
            return int(client.status()['received'])
        client.spin_until(lambda: play(tracker._stamp, tracker.positions[:1]) or received()
                          > 0, 'no point is received')
        before = received()
        play(tracker._stamp, tracker.positions[:100])
        client.spin_until(lambda: received() >= before + 100, 'points were lost')
        play(500.0, tracker.positions[:100])
        client.spin_until(lambda: received() == 100, 'points were lost, or not dropped')
        assert NEW_SESSION in client.status()['message'] and node.log.count(NEW_SESSION) == 1
