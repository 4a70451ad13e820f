# SPDX-License-Identifier: Apache-2.0
"""What each topic of a tracker carries: positions of a tip, or poses of a tool or array."""

from __future__ import annotations

from typing import Any, Protocol

from rclpy.topic_endpoint_info import TopicEndpointInfo

from msg_adapters.motion import POINT, TOOL_POSES
from msg_adapters.ros_definitions import message_class

MESSAGES: dict[str, Any] = {kind: message_class(kind) for kind in (POINT, *TOOL_POSES)}


class Graph(Protocol):
    """The part of the node that reports the published types."""

    def get_publishers_info_by_topic(self, topic_name: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic."""

    def resolve_topic_name(self, topic: str) -> str:
        """Return the name of a topic after remapping."""


def accepted_types(probe_type: str) -> tuple[str, ...]:
    """Return the message types that ``probe.type`` allows."""
    return {'point': (POINT,), 'pose': tuple(TOOL_POSES)}.get(probe_type, tuple(MESSAGES))


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
