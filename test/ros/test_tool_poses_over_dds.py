# SPDX-License-Identifier: Apache-2.0
"""Poses of a tool instead of positions of its tip, calibrations and bad orientations, over DDS."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from ros_support import Client, NodeProcess, Tracker
from test_moving_reference import ARRAY, RATE, STILL, T_TRACKER_ARRAY, MovingTracker, reliable

from gsdf_registration.common.rigid import from_rt, inverse, rotation_exp, transform
from gsdf_registration.simulation.moving import Sway
from gsdf_registration.simulation.pivoting import HIP_CENTRE, TIP, leg_swing, pivoting
from msg_adapters import ros
from msg_adapters.settings_file import read_config

pytestmark = pytest.mark.ros
DOUBLES = Parameter.Type.DOUBLE_ARRAY


class ToolTracker(MovingTracker):
    """Publishes poses of a tool whose tip is at `TIP`; it tilts as the tip moves on the bone."""

    KIND = PoseStamped
    sway: Sway

    def message(self, position: np.ndarray, frame_id: str, stamp: Any) -> PoseStamped:
        T_tracker_array = self.sway.pose(ros.stamp_to_seconds(stamp))
        R = T_tracker_array[:3, :3] @ rotation_exp(
            5.0 * transform(inverse(T_tracker_array), position))
        return ros.pose_msg(from_rt(R, position - R @ np.array(TIP)), frame_id, stamp)

    def send(self, positions: np.ndarray, steps: np.ndarray | float = 0.0125,
             topic: str = '', frame_id: str = 'tracker') -> None:
        """Publish poses of the tool with the tip at these positions, always on its own topic."""
        super().send(positions, steps, '/pointer/measured_cp', frame_id)

    def send_poses(self, T: np.ndarray, rate: float) -> None:
        """Publish poses (n, 4, 4) of the tool, without the array."""
        for each in T:
            self._stamp += 1.0 / rate
            self._publishers['/pointer/measured_cp'].publish(
                ros.pose_msg(each, 'tracker', ros.seconds_to_stamp(self._stamp)))
            time.sleep(0.0005)      # no faster than a real tracker

    def send_array_poses(self, T: np.ndarray, rate: float) -> None:
        """Publish poses (n, 4, 4) of the reference array alone."""
        self._next = max(self._next, self._stamp) + 1.0
        for each in T:
            self._next += 1.0 / rate
            self._motion.publish(ros.pose_msg(each, 'tracker', ros.seconds_to_stamp(self._next)))
            time.sleep(0.0005)
        self._stamp = self._next


@pytest.fixture(scope='module')
def node(parameters: dict[str, Any],
         tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    names = [*parameters['landmarks.names'], 'hip_centre']
    positions = parameters['landmarks.positions'].replace(']', ', 0.01, 0.02, 0.03]')
    node = NodeProcess(tmp_path_factory.mktemp('tool') / 'log', 'tool', **{
        **parameters, 'probe.topics': ['/pointer/measured_cp'], 'reference.topic': ARRAY,
        'live.enabled': 'false', 'landmarks.names': names, 'landmarks.positions': positions})
    yield node
    node.stop()


@pytest.fixture(scope='module')
def tool(node: NodeProcess) -> Iterator[ToolTracker]:
    with Client(node) as client:
        client.await_state('active')
        sway = Sway(Tracker(client, []).truth.T_tracker_bone @ T_TRACKER_ARRAY)

        def array_at(stamp: float) -> PoseStamped:
            return ros.pose_msg(sway.pose(stamp), 'tracker', ros.seconds_to_stamp(stamp))

        def place(stamp: float, position: np.ndarray) -> np.ndarray:
            return transform(sway.pose(stamp) @ inverse(sway.T_tracker_body), position)
        tracker = ToolTracker(client, ['/pointer/measured_cp'], 'tracker',
                              reliable(client, PoseStamped, ARRAY), array_at, place)
        tracker.sway = sway
        tracker.await_listener()
        yield tracker


def set_tip(client: Client, tip: Any) -> None:
    assert client.set_parameters(Parameter('probe.tip', DOUBLES, list(tip))) == ''


def assert_registers(tool: ToolTracker) -> None:
    answer = tool.client.ask('register')
    assert answer.success, answer.message
    _, T, frame_id = ros.pose_from(tool.client.receive(PoseStamped, '~/bone_pose'))
    assert frame_id == 'tool_reference_array'
    T_tracker_array = tool.truth.T_tracker_bone @ T_TRACKER_ARRAY
    tool.assert_near_truth(T_tracker_array @ T, STILL)


def test_registers_poses_of_a_tool_on_a_moving_bone(tool: ToolTracker) -> None:
    client = tool.client
    assert client.ask('clear').success
    set_tip(client, TIP)
    tool.touch_landmarks(STILL)
    tool.drag(STILL)
    assert_registers(tool)
    set_tip(client, np.array(TIP) + [0.0, 0.0, 0.001])
    status = client.status(pose='none', withdrawn='tip_changed')
    assert 'register again' in status['message']


def test_points_of_a_tool_wait_for_its_tip(tool: ToolTracker, node: NodeProcess) -> None:
    client = tool.client
    set_tip(client, [])
    assert client.ask('clear').success
    tool.touch_landmarks(STILL)
    tool.drag(STILL)
    kept = client.status()['kept']
    answer = client.ask('register')
    assert not answer.success and 'probe.tip is not set' in answer.message
    assert 'probe.tip is not set' in client.status()['message']

    assert 'divot' in client.ask('calibrate_tip').message
    recording = pivoting(np.random.default_rng(0), seconds=15.0)
    tool.send_poses(recording.T_tracker_body, 40.0)
    count = str(len(recording.stamps))
    client.spin_until(lambda: client.status()['rejected.calibrating'] == count, 'poses were lost')
    assert f'{count} poses so far' in client.status(calibration__poses=count)['message']
    answer = client.ask('calibrate_tip')
    assert answer.success, answer.message
    path = Path(str(node.log_file.with_suffix('')) + '.tip.yaml')
    assert f'written to {path}' in answer.message
    tip = read_config(str(path)).probe.tip
    assert np.linalg.norm(np.array(tip) - TIP) < 2e-4
    assert client.status()['kept'] == kept
    assert_registers(tool)


def test_counts_poses_without_a_unit_quaternion(tool: ToolTracker) -> None:
    client = tool.client
    assert client.ask('clear').success
    client.collect(True)
    for w in (0.0, 0.99, float('nan'), 1.0):
        tool.publish_motion_until(tool._stamp + 0.1)
        tool._stamp += 0.05
        message = ros.pose_msg(np.eye(4), 'tracker', ros.seconds_to_stamp(tool._stamp))
        message.pose.orientation.w = w
        tool._publishers['/pointer/measured_cp'].publish(message)
    tool.publish_motion_until(tool._stamp + 0.1)
    client.status(received='4', kept='1', rejected__bad_quaternion='3')
    client.collect(False)


def test_finds_the_centre_of_a_joint_as_a_landmark(tool: ToolTracker) -> None:
    client = tool.client
    assert client.ask('clear').success
    assert 'swing' in client.ask('find_joint_centre').message
    assert not client.ask('calibrate_tip').success
    swing = leg_swing(np.random.default_rng(1), seconds=10.0, rate=RATE / 2)
    tool.send_array_poses(swing.T_tracker_body, RATE / 2)
    client.spin_until(lambda: client.status().get('calibration.poses') == str(len(swing.stamps)),
                      'poses were lost')
    answer = client.ask('find_joint_centre')
    assert answer.success and 'landmark "hip_centre" found' in answer.message, answer.message
    assert client.status()['landmarks'] == '1'
    found = np.array(json.loads(answer.message.split(' at ')[1].split(' mm')[0]))
    assert np.linalg.norm(1e-3 * found - HIP_CENTRE) < 0.005


def test_a_clear_cancels_a_calibration(tool: ToolTracker) -> None:
    client = tool.client
    assert client.ask('calibrate_tip').success
    assert 'calibration is cancelled' in client.ask('clear').message
    assert 'calibrating' not in client.status(calibration='')['message']


def test_follows_the_type_that_is_published(tool: ToolTracker) -> None:
    client = tool.client
    assert client.ask('clear').success
    assert client.set_parameters(Parameter('probe.topics', value=['/other/tool'])) == ''
    pose = ros.pose_msg(np.eye(4), 'tracker', ros.seconds_to_stamp(1.0))
    messages = [
        ros.pose_with_covariance_msg(np.eye(4), np.eye(6), 'tracker', pose.header.stamp),
        ros.transform_msg(np.eye(4), 'tracker', 'tool', pose.header.stamp),
        ros.point_msg([0.0, 0.0, 0.0], 'tracker', pose.header.stamp)]
    try:
        for message in messages:
            publisher = reliable(client, type(message), '/other/tool')
            publisher.publish(message)
            client.status(received='1')
            client.node.destroy_publisher(publisher)
            assert client.ask('clear').success
    finally:
        back = Parameter('probe.topics', value=['/pointer/measured_cp'])
        assert client.set_parameters(back) == ''
