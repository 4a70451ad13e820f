# SPDX-License-Identifier: Apache-2.0
"""
What is heard on /tf and /tf_static.

The buffer is our own (`Frames`) and not that of tf2_ros, which has no wheel and bridges a gap of
any length: so wheels and a ROS install behave alike, offline and node do, and /tf follows the very
rules of the reference array.
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
except ImportError:     # not among the wheels; on a ROS install it is there
    TFMessage = None

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.node.qos import POINTS
from msg_adapters import ros

# as tf2_ros listens: each broadcaster keeps its transforms for late joiners
STATIC = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE,
                    durability=DurabilityPolicy.TRANSIENT_LOCAL)

LONGEST = 10.0      # s; of what seems to have waited for longer the clock was set meanwhile

# parent, child, stamp (s), T_parent_child (4, 4), whether for all times, s it waited for us
Take = Callable[[str, str, float, Array, bool, float], None]


def is_heard() -> bool:
    """Tell whether /tf can be listened to here."""
    return TFMessage is not None


class Transforms:
    """Passes on every transform that is heard; one that is no rigid motion is left out."""

    def __init__(self, node: Node, take: Take) -> None:
        self._node = node
        self._subscribed = [
            node.create_subscription(TFMessage, topic, partial(_pass_on, take, fixed), qos)
            for topic, fixed, qos in (('/tf', False, POINTS), ('/tf_static', True, STATIC))]

    def destroy(self) -> None:
        """Listen no more."""
        for subscription in self._subscribed:
            self._node.destroy_subscription(subscription)


def waited_for_us(info: dict[str, Any]) -> float:
    """Return how long ago, s, a message was received, as far as the middleware tells."""
    received = info['received_timestamp']
    return min(max(time.time() - 1e-9 * received, 0.0), LONGEST) if received else 0.0


def _pass_on(take: Take, fixed: bool, message: Any, info: dict[str, Any]) -> None:
    waited = waited_for_us(info)
    for each in message.transforms:
        try:
            stamp, T, parent, child = ros.transform_from(each)
        except InputError:
            continue
        take(parent, child, stamp, T, fixed, waited)
