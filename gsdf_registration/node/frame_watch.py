# SPDX-License-Identifier: Apache-2.0
"""Detects that another program sends the transform of the bone frame, so that the bone jumps."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from geometry_msgs.msg import TransformStamped
from rclpy.serialization import deserialize_message

try:
    from tf2_msgs.msg import TFMessage
except ImportError:     # there is no wheel of it; a ROS installation has it
    TFMessage = None

from gsdf_registration.node.qos import POINTS, UNWATCHED_POINTS
from gsdf_registration.node.transforms import STATIC

MEMORY = 5000       # own transforms that may still be on their way, 5 s at the maximum of tf.rate
LIFETIME = 5.0      # s after the last such transform for which the problem is reported


class TopicNode(Protocol):
    """The node, as far as the watch uses it."""

    def create_subscription(self, msg_type: Any, topic: str, callback: Callable[[bytes], None],
                            qos_profile: Any, *, event_callbacks: Any, raw: bool) -> Any:
        """Create a subscription."""

    def destroy_subscription(self, subscription: Any) -> Any:
        """Remove a subscription."""


class FrameWatch:
    """
    Receives /tf and /tf_static while the node sends the transform of ``frame_id``.

    A message is deserialized only if it contains the name of the frame: a robot sends its joints
    hundreds of times a second.
    """

    def __init__(self, node: TopicNode, frame_id: str) -> None:
        self._node = node
        self._frame_id = frame_id
        self._name = frame_id.encode() + b'\0'      # as a string is serialized
        self._own: deque[tuple[Any, ...]] = deque(maxlen=MEMORY)
        self._subscriptions: list[Any] = []
        self._parent, self._until = '', 0.0

    def start(self) -> None:
        """Watch from now on."""
        if TFMessage is None or self._subscriptions:
            return
        self._subscriptions = [
            self._node.create_subscription(TFMessage, topic, partial(self._receive, lifetime), qos,
                                           event_callbacks=UNWATCHED_POINTS, raw=True)
            for topic, lifetime, qos in (('/tf', LIFETIME, POINTS),
                                         ('/tf_static', float('inf'), STATIC))]

    def stop(self) -> None:
        """Watch no longer, and forget what was found."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._until = 0.0

    def sent(self, transform: TransformStamped) -> None:
        """Record a transform that this node sends, before it is sent."""
        self._own.append(_content(transform))

    @property
    def problem(self) -> str:
        """What is wrong and what to do; empty if this node alone sends the transform."""
        if time.monotonic() > self._until:
            return ''
        return (f'another program sends a transform of {self._frame_id} too, from '
                f'{self._parent}, and the bone jumps between the two: stop it, or give this node '
                'another model.frame_id or namespace')

    def _receive(self, lifetime: float, serialized: bytes) -> None:
        if self._name not in serialized:
            return
        for each in deserialize_message(serialized, TFMessage).transforms:
            ours = each.child_frame_id.lstrip('/') == self._frame_id
            if ours and _content(each) not in self._own:
                self._parent = each.header.frame_id
                self._until = max(self._until, time.monotonic() + lifetime)


def _content(transform: TransformStamped) -> tuple[Any, ...]:
    """Return what distinguishes a transform from those of other programs."""
    stamp, shift = transform.header.stamp, transform.transform.translation
    turn = transform.transform.rotation
    return (stamp.sec, stamp.nanosec, transform.header.frame_id, shift.x, shift.y, shift.z,
            turn.x, turn.y, turn.z, turn.w)
