# SPDX-License-Identifier: Apache-2.0
"""A recording that another process plays gives the pose of the bone."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from ros_support import BAG, ENDS_WITH_TESTS, ROOT, Client, NodeProcess, Tracker

from msg_adapters import ros

pytestmark = pytest.mark.ros


def player(*options: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*ENDS_WITH_TESTS, sys.executable, '-m', 'gsdf_registration.clients.player',
         str(BAG), *options],
        cwd=ROOT)


@pytest.mark.parametrize('options, topics', [
    (['--rate', '8'], ['/probe/tip']),
    # slower: dropped messages are not sent again
    (['--rate', '4', '--best-effort'], ['/probe/tip', '/probe/second']),
], ids=['reliable', 'best effort, two probes'])
def test_registers_a_played_recording(shared_node: NodeProcess, tracker: Tracker,
                                      options: list[str], topics: list[str]) -> None:
    client = tracker.client
    with player('--topic', '/probe/landmarks', *options):
        for name in tracker.truth.landmark_names:
            client.spin_until(lambda: client.ask('capture_landmark').success,
                              f'{name} was not captured')
    client.collect(True)
    players = [player('--topic', '/probe/tip', '--as', topic, *options) for topic in topics]
    assert [process.wait() for process in players] == [0] * len(topics)
    client.collect(False)
    answer = client.ask('register')
    assert answer.success, answer.message

    with Client(shared_node) as late_joiner:
        pose = late_joiner.receive(PoseStamped, '~/bone_pose')
        with_covariance = late_joiner.receive(PoseWithCovarianceStamped,
                                              '~/bone_pose_with_covariance')
        status = late_joiner.status(state='registered')
    _, T, frame_id = ros.pose_from(pose)
    assert frame_id == 'tracker'
    tracker.assert_near_truth(T, np.eye(4))
    assert with_covariance.pose.pose == pose.pose
    assert np.linalg.eigvalsh(np.reshape(with_covariance.pose.covariance, (6, 6))).min() > 0.0
    assert int(status['kept']) > 600 * len(topics)
    assert status['landmarks'] == '3'
