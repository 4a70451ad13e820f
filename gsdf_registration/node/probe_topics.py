# SPDX-License-Identifier: Apache-2.0
"""What each topic of a tracker carries: positions of a tip, or poses of a tool or array."""

from __future__ import annotations

from typing import Any, Protocol

from geometry_msgs.msg import (
    PointStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
    TransformStamped,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

POINT = 'geometry_msgs/msg/PointStamped'
POSE = 'geometry_msgs/msg/PoseStamped'
MESSAGES: dict[str, Any] = {
    POINT: PointStamped, POSE: PoseStamped,
    'geometry_msgs/msg/PoseWithCovarianceStamped': PoseWithCovarianceStamped,
    'geometry_msgs/msg/TransformStamped': TransformStamped
}


class Graph(Protocol):
    """The node, as far as it tells which types are published."""

    def get_publishers_info_by_topic(self, topic_name: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic."""

    def resolve_topic_name(self, topic: str) -> str:
        """Return the name of a topic after remapping."""


def accepted_types(probe_type: str) -> tuple[str, ...]:
    """Return the message types that ``probe.type`` allows."""
    return {'point': (POINT,), 'pose': tuple(kind for kind in MESSAGES if kind != POINT)}.get(
        probe_type, tuple(MESSAGES))


def type_to_receive(graph: Graph, topic: str, probe_type: str, current: str) -> str:
    """
    Return the message type to receive on a topic.

    Parameters
    ----------
    graph : the node
    topic : str
    probe_type : str, ``probe.type``
    current : str
        The type received so far; it stays while it is published, and while nothing else is.
        Empty: none.

    """
    accepted = accepted_types(probe_type)
    published = [info.topic_type
                 for info in graph.get_publishers_info_by_topic(graph.resolve_topic_name(topic))
                 if info.topic_type in accepted]
    if current in accepted and (current in published or not published):
        return current
    return published[0] if published else accepted[0]
