# SPDX-License-Identifier: Apache-2.0
"""The log stays short at any rate of invalid messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_support import Client, NodeProcess, Tracker

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
MANY = 300


def test_no_stream_of_messages_floods_the_log(start_node: StartNode,
                                              parameters: dict[str, Any]) -> None:
    node = start_node('flooded', **parameters | {
        'probe.topics': ['/probe/tip'], 'collect.automatic': 'true', 'gate.max_age': '0.05',
        'reference.topic': '/array'})
    with Client(node) as client:
        client.await_state('active')
        tracker = Tracker(client, ['/probe/tip'])
        reliable = QoSProfile(depth=MANY, reliability=ReliabilityPolicy.RELIABLE)
        array = client.node.create_publisher(PoseStamped, '/array', reliable)
        tracker.client.spin_until(array.get_subscription_count, '/array has no subscription')
        before = len(node.log.splitlines())
        for _ in range(MANY):
            array.publish(PoseStamped())        # a quaternion of zeros
        tracker.send(np.full((MANY, 3), np.nan))
        tracker.send(np.zeros((MANY, 3)), frame_id='elsewhere')
        tracker.send(np.random.default_rng(0).normal(0.0, 10.0, (MANY, 3)))
        for back in range(30):      # a recording of three points in a loop
            tracker._stamp = 500.0 - 10.0 * back
            tracker.send(np.zeros((4, 3)))
        for _ in range(100):
            client.ask('capture_landmark')
            client.ask('register')
        assert int(client.status()['received']) > 0
        assert len(node.log.splitlines()) - before < 60, node.log
