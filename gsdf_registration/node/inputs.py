# SPDX-License-Identifier: Apache-2.0
"""What the node hears: the tip of each probe."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from geometry_msgs.msg import PointStamped

from gsdf_registration.config import Config
from gsdf_registration.node.qos import POINTS
from msg_adapters import ros

if TYPE_CHECKING:
    from gsdf_registration.node.node import RegistrationNode


class Inputs:
    """Subscribes to the topics of ``config`` and hands what they bring to the node."""

    def __init__(self, node: RegistrationNode, config: Config) -> None:
        self._node = node
        self._subscribed = [
            node.create_subscription(PointStamped, topic, partial(self._on_point, topic), POINTS)
            for topic in config.probe.topics]

    def destroy(self) -> None:
        """Listen no more."""
        for subscription in self._subscribed:
            self._node.destroy_subscription(subscription)

    def _on_point(self, topic: str, message: PointStamped) -> None:
        if self._node.state == 'active':
            stamp, position, frame_id = ros.point_from(message)
            self._node.take_point(stamp, position.tolist(), frame_id, topic)
