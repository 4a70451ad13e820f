# SPDX-License-Identifier: Apache-2.0
"""What the node hears: the tip of each probe, the reference array, the frames of /tf, its clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.node import transforms
from gsdf_registration.node.qos import POINTS, UNWATCHED_POINTS
from gsdf_registration.tracking.clock import BACK
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.point_transformer import PointTransformer
from msg_adapters import ros
from msg_adapters.motion import NO_MOTION

if TYPE_CHECKING:
    from gsdf_registration.node.node import RegistrationNode

PERIOD = 0.1        # s, between two looks at whether a point has waited for too long
SELDOM = 1.0        # s, the same where none can have waited
MOST_AT_ONCE = 2000     # messages of a topic; then others have their turn
RECENT = 3.0        # s for which it is told why points have been refused
QUIET = 10.0        # s, between two lines of the log on the same thing


class Inputs:
    """Hears the topics of ``config`` and hands their points to the node, in the session's frame."""

    def __init__(self, node: RegistrationNode, config: Config) -> None:
        self._node = node
        self._feed = PointTransformer(config, self, None)
        self._refused = -RECENT     # when a point was last refused here, s
        self._behind = 0.0      # s that the last message which tells of motion waited for us
        self._frames: Frames | None = None
        self._transforms: transforms.Transforms | None = None
        self._subscribed: list[Subscription] = []
        for topic in config.probe.topics:
            self._hear(PointStamped, topic, partial(self._on_point, topic))
        if config.reference.topic:
            self._hear(PoseStamped, config.reference.topic, self._on_pose)
        self._timer: Timer | None = None
        back = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-BACK),
                             on_clock_change=False)
        self._jumps = node.get_clock().create_jump_callback(back, post_callback=self._on_jump)
        self.configure(config)

    def configure(self, config: Config) -> None:
        """Work by these settings from now on; /tf costs time, so it is heard only when needed."""
        wanted = bool(config.points_frame) and transforms.is_heard()
        if wanted and self._transforms is None:
            self._frames = Frames()
            self._transforms = transforms.Transforms(self._node, self._on_transform)
        elif not wanted and self._transforms is not None:
            self._transforms.destroy()
            self._frames = self._transforms = None
        self._feed.configure(config, self._frames)
        # without either no point ever waits, and looking costs time, too
        waits = config.reference.topic or self._transforms is not None
        self._stop_looking()
        self._timer = self._node.create_timer(PERIOD if waits else SELDOM, self._look)

    def _hear(self, kind: Any, topic: str, take: Callable[[Any, dict[str, Any]], None]) -> None:
        """
        Hear a topic, with each message all that wait behind it.

        rclpy by itself takes one in a turn, and then a service, which is asked of a tip at rest or
        of the points so far: where it was held up, that would answer from the past.
        """
        def take_all(message: Any, info: dict[str, Any]) -> None:
            take(message, info)
            for _ in range(MOST_AT_ONCE):
                waiting = subscription.handle.take_message(kind, False)
                if waiting is None:
                    return
                take(*waiting)
        on_message: Any = take_all      # of two arguments, which rclpy takes but does not say
        subscription = self._node.create_subscription(kind, topic, on_message, POINTS,
                                                      event_callbacks=UNWATCHED_POINTS)
        self._subscribed.append(subscription)

    def destroy(self) -> None:
        """Listen no more."""
        self._jumps.unregister()
        self._stop_looking()
        for subscription in self._subscribed:
            self._node.destroy_subscription(subscription)
        if self._transforms is not None:
            self._transforms.destroy()

    def _stop_looking(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)

    def forget(self) -> None:
        """Take what comes next as the first of a new session."""
        self._feed.forget()

    @property
    def trouble(self) -> str:
        """Why points are being refused before they reach the session; else an empty string."""
        return self._feed.trouble if time.monotonic() - self._refused < RECENT else ''

    def take(self, sample: Sample) -> None:
        """Hand a point in the frame of the session to the node."""
        self._node.take_point(sample.stamp, sample.position, sample.frame_id, sample.source,
                              sample.arrival)

    def refuse(self, sample: Sample, cause: Rejection) -> None:
        """Count a point that does not reach the session."""
        self._refused = time.monotonic()
        self._node.session.count_dropped({cause.value: 1})

    def start_anew(self, why: str) -> None:
        """Have the node begin a new session."""
        self._node.start_anew(why)

    def _on_point(self, topic: str, message: PointStamped, info: dict[str, Any]) -> None:
        if self._node.state == 'active':
            stamp, position, frame_id = ros.point_from(message)
            arrival = self._node.now() - transforms.waited_for_us(info)
            self._feed.point(Sample(stamp, position.tolist(), frame_id, topic, arrival))

    def _on_transform(self, parent: str, child: str, stamp: float, T: Array, fixed: bool,
                      waited: float) -> None:
        self._behind = waited
        self._feed.transform(parent, child, stamp, T, fixed)

    def _on_pose(self, message: PoseStamped, info: dict[str, Any]) -> None:
        self._behind = transforms.waited_for_us(info)
        try:
            _, T, _ = ros.pose_from(message)
        except InputError:
            T = NO_MOTION
        header = message.header
        self._feed.pose(ros.stamp_to_seconds(header.stamp), T, header.frame_id)

    def _on_jump(self, jump: TimeJump) -> None:
        if self._node.state == 'active':
            now = self._node.now()
            self._feed.our_clock_went_back(now - jump.delta.nanoseconds * 1e-9, now)

    def _look(self) -> None:
        # what has been received but not been looked at yet may be what a point waits for
        self._feed.serve(self._node.now() - self._behind)
        self._behind = 0.0
        if self.trouble:
            self._node.get_logger().warning(self.trouble, throttle_duration_sec=QUIET)
