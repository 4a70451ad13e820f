# SPDX-License-Identifier: Apache-2.0
"""
The publisher of ``~/events``: what the operator did, with its place among the samples.

A recording of the topics of the tracker and of this one can be replayed, see `session.replay`.
"""

from __future__ import annotations

import contextlib
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.result import InputError
from gsdf_registration.session.landmark_capture import Answer
from msg_adapters import ros

# A recorder that starts late receives the whole history: an operation has some hundred requests
HISTORY = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
DONE = Answer(True, '')
VALUES = ('data', 'stroke')     # fields of requests, beside initial poses


class Place(NamedTuple):
    """The place of an event: its number and time, s, and what had been received before it."""

    number: int
    stamp: float
    kept: int
    last: dict[str, tuple[int, float]]


class EventPublisher:
    """
    Publishes ``~/events`` (latched, with its history) in every state of the node.

    Attributes
    ----------
    last : dict of str to (int, float)
        Number and stamp, s, of the last message on each topic of the tracker; to be kept up to
        date by `Inputs`.

    """

    def __init__(self, node: Node) -> None:
        self.last: dict[str, tuple[int, float]] = {}
        self._node = node
        self._number = 0
        self._publisher = node.create_publisher(DiagnosticStatus, '~/events', HISTORY)

    def begin(self, kept: int) -> Place:
        """Return the place of an event that begins now; ``kept``: number of points collected."""
        self._number += 1
        return Place(self._number, self._node.get_clock().now().nanoseconds * 1e-9, kept,
                     dict(self.last))

    def publish(self, name: str, place: Place, answer: Answer = DONE,
                request: dict[str, Any] | None = None, performed: bool = True,
                follow_up: str = '') -> None:
        """Publish an event; the values are those of `OperatorEvent`."""
        event = OperatorEvent(place.number, name, place.stamp, answer.success, answer.message,
                              request or {}, performed, follow_up, place.kept, place.last)
        self._publisher.publish(ros.event_msg(event, self._node.get_fully_qualified_name()))


def request_values(request: Any) -> dict[str, Any]:
    """Return the values of a request, as for JSON; of an initial pose, T_tracker_bone (4, 4)."""
    values = {name: getattr(request, name) for name in VALUES if hasattr(request, name)}
    if getattr(request, 'use_initial_pose', False):
        with contextlib.suppress(InputError):       # the request is refused for it
            values['T_tracker_bone'] = ros.pose_from(request.initial_pose)[1].tolist()
    return values
