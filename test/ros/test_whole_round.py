# SPDX-License-Identifier: Apache-2.0
"""A complete procedure with a node that is killed in between: every message is true."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_support import BAG, Client, NodeProcess, Tracker, values

from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.node.qos import LATCHED
from gsdf_registration.session.landmark_capture import Answer
from msg_adapters import ros

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
STILL = np.eye(4)
ENOUGH = 300        # points of the recording
MAX_ERROR = 0.003   # m, of a live pose at a landmark


class Monitor:
    """Receives all status messages and live poses of a node."""

    def __init__(self, tracker: Tracker, name: str) -> None:
        self.statuses: list[dict[str, str]] = []
        self.errors: list[float] = []
        self._truth = tracker.truth
        node = tracker.client.node
        node.create_subscription(DiagnosticStatus, f'/{name}/status', self._on_status, LATCHED)
        node.create_subscription(PoseWithCovarianceStamped, f'/{name}/live_pose', self._on_pose,
                                 QoSProfile(depth=10_000))

    def _on_status(self, status: DiagnosticStatus) -> None:
        self.statuses.append({**values(status), 'message': status.message, 'stamp': ''})

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        T = ros.pose_from(PoseStamped(header=message.header, pose=message.pose.pose))[1]
        places = self._truth.landmarks_model
        difference = transform(T, places) - transform(self._truth.T_tracker_bone, places)
        self.errors.append(float(np.linalg.norm(difference, axis=1).max()))

    def check(self) -> None:
        """Check that no status is repeated, premature or outdated."""
        assert len(self.errors) > 5 and max(self.errors) < MAX_ERROR
        assert all(now != before for before, now in zip(self.statuses, self.statuses[1:]))
        for status in self.statuses:
            kept, message = int(status['kept']), status['message']
            assert kept > 50 or 'enough' not in message
            assert kept < 60 or 'too few' not in message
            assert 'next landmark' not in message or 'drag' not in message
            assert status['state'] in ('ready', 'registered') or 'register now' not in message


def verify(tracker: Tracker, place: Array) -> Answer:
    """Hold the tip there until it is verified, and return the answer."""
    rng = np.random.default_rng(0)
    answer = Answer(False, 'not verified')
    while answer.message.startswith('not verified'):
        tracker.send(place + rng.normal(0.0, 5e-5, (60, 3)))
        answer = tracker.client.ask('verify')
    return answer


def test_complete_procedure(start_node: StartNode, parameters: dict[str, Any], tmp_path: Path,
                       hip_surface: tuple[Array, Array]) -> None:
    given = parameters | {'session.path': tmp_path / 'round.json', 'session.resume': 'true',
                          'collect.automatic': 'true', 'probe.topics': ['/probe/tip']}
    node = start_node('round', **given)
    with Client(node) as client:
        client.await_state('active')
        tracker = Tracker(client, ['/probe/tip'])
        tracker.await_listener()
        monitor = Monitor(tracker, 'round')
        T = tracker.truth.T_tracker_bone
        assert 'too few' in client.ask('register').message
        tracker.touch_landmarks(STILL)

        tracker.send(tracker.positions[:ENOUGH], tracker.steps[:ENOUGH])
        client.status(state='ready')
        client.collect(True)        # not on the bone
        line = np.linspace([0.0, 0.09, 0.06], [0.03, 0.09, 0.06], 80)
        tracker.send(transform(T, line) + np.random.default_rng(0).normal(0.0, 1e-4, (80, 3)))
        client.status(received=str(ENOUGH + 230))
        answer = client.ask('register')
        assert answer.success and 'none on the bone: interference' in answer.message
        answer = client.ask('undo')
        assert answer.success and 'registered again without it' in answer.message
        assert 'until the next' not in answer.message and 'interference' not in answer.message

        surface = trimesh.Trimesh(*hip_surface, process=False)
        row = surface.kdtree.query(transform(inverse(T), tracker.positions[50]))[1]
        place, normal = surface.vertices[row], surface.vertex_normals[row]
        answer = verify(tracker, transform(T, place))
        assert answer.success, answer.message
        answer = verify(tracker, transform(T, place + 0.006 * normal))
        assert not answer.success and 'beyond the 2.0 mm' in answer.message
        answer = verify(tracker, transform(T, place) + [0.0, 0.0, 0.003])
        assert not answer.success and 'was the array displaced?' in answer.message
        assert client.status(pose='none', withdrawn='array_displaced')['state'] != 'registered'
        assert client.ask('register').success       # another place was touched
        assert client.ask('save').success
        before = client.status(state='registered')
        found = ros.pose_from(client.receive(PoseStamped, '~/bone_pose'))[1]
        monitor.check()
        assert len([1 for line in node.log.splitlines() if 'register now' in line]) == 1
        stamp = tracker._stamp
        tracker.send(tracker.positions[ENOUGH:], tracker.steps[ENOUGH:])    # until it is killed
    node.process.send_signal(signal.SIGKILL)
    node.process.wait()
    assert 'Traceback' not in node.log

    node = start_node('round', **given)
    with Client(node) as client:
        client.await_state('active')
        status = client.status(pose='in tracker')
        assert int(status['kept']) >= int(before['kept'])
        assert status['verification'] == before['verification'] and status['landmarks'] == '3'
        again = ros.pose_from(client.receive(PoseStamped, '~/bone_pose'))[1]
        np.testing.assert_allclose(again, found, atol=1e-9)
        tracker = Tracker(client, ['/probe/tip'])
        tracker._stamp = stamp + 60.0
        assert client.ask('register').success
        # pose and landmarks do not apply to another bone, and a registration on it is refused
        femur = str(BAG.parent / 'femur.ply')
        assert client.set_parameters(Parameter('model.path', value=femur)) == ''
        client.status(pose='none', landmarks='0', withdrawn='model_changed')
        answer = client.ask('register')
        assert not answer.success and 'kept' not in answer.message
        assert 'belongs to another bone' in client.ask('load').message
        assert 'Traceback' not in node.log
