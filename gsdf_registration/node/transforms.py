# SPDX-License-Identifier: Apache-2.0
"""
Subscriptions to /tf and /tf_static.

The buffer is `Frames` and not the one of tf2_ros: tf2_ros has no wheel and interpolates over gaps
of any length. So a ROS install and wheels, the node and the offline replay behave in the same way,
and /tf follows the same rules as the reference array.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

try:
    from tf2_msgs.msg import TFMessage
except ImportError:     # there is no wheel of it; a ROS install has it
    TFMessage = None

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.node.qos import POINTS
from msg_adapters import ros

# as in tf2_ros: broadcasters keep static transforms for late subscribers
STATIC = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE,
                    durability=DurabilityPolicy.TRANSIENT_LOCAL)

MAX_DELAY = 10.0    # s; a longer apparent delay means that the system clock was set meanwhile

# parent, child, stamp (s), T_parent_child (4, 4), whether static, delay in the queue (s)
TransformCallback = Callable[[str, str, float, Array, bool, float], None]


def is_available() -> bool:
    """Return whether the messages of /tf are installed."""
    return TFMessage is not None


class Transforms:
    """Passes every rigid transform on /tf and /tf_static to a callback; others are ignored."""

    def __init__(self, node: Node, callback: TransformCallback) -> None:
        self._node = node
        self._subscriptions = [
            node.create_subscription(TFMessage, topic, partial(_forward, callback, static), qos)
            for topic, static, qos in (('/tf', False, POINTS), ('/tf_static', True, STATIC))]

    def destroy(self) -> None:
        """Remove the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)


def queue_delay(info: dict[str, Any]) -> float:
    """Return how long ago a message was received, s; 0 if the middleware does not report it."""
    received = info['received_timestamp']
    return min(max(time.time() - 1e-9 * received, 0.0), MAX_DELAY) if received else 0.0


def _forward(callback: TransformCallback, static: bool, message: Any,
             info: dict[str, Any]) -> None:
    delay = queue_delay(info)
    for each in message.transforms:
        try:
            stamp, T, parent, child = ros.transform_from(each)
        except InputError:
            continue
        callback(parent, child, stamp, T, static, delay)
