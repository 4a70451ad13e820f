# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of the node: tips of the probes, reference array, /tf; and jumps of its clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

from geometry_msgs.msg import PointStamped
from rclpy.clock import ClockChange, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Sample, SampleSink
from gsdf_registration.node import transforms
from gsdf_registration.node.hints import Arrivals, type_name
from gsdf_registration.node.lifecycle import RCLError
from gsdf_registration.node.probe_topics import MESSAGES, type_to_receive
from gsdf_registration.node.qos import POINTS, STEADY, UNWATCHED_POINTS
from gsdf_registration.tracking.clock import BACK
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.point_transformer import PointTransformer
from msg_adapters import ros
from msg_adapters.motion import INVALID_TRANSFORM, POINT, TOOL_POSES, to_matrix
from msg_adapters.ros_lost_messages import LostMessages

PERIOD = 0.1        # s, between two checks for points that have waited too long
IDLE_PERIOD = 1.0   # s, the same if no point can wait
TYPE_PERIOD = 0.1   # s, between two looks at the types that are published
MAX_BATCH = 2000    # messages of one topic per callback; then other topics are served
SHOW_FOR = 3.0      # s for which the status says why points were rejected
LOG_PERIOD = 10.0   # s, between two equal log lines


class Inputs:
    """
    Receives the topics of ``config`` and passes their points to a session, in the session frame.

    Points are ignored unless ``active``; poses and transforms are always received.  What a topic
    carries is found from its publishers, now and later, see `type_to_receive`.

    Parameters
    ----------
    node, config, session
    last : dict of str to (int, float)
        Number and stamp, s, of the last message on each topic, kept up to date.
    types : message type by topic, as these inputs' predecessors received them

    """

    def __init__(self, node: Node, config: Config, session: SampleSink,
                 last: dict[str, tuple[int, float]],
                 types: Mapping[str, str] = MappingProxyType({})) -> None:
        self.active = False
        self.types: dict[str, str] = {}     # message type received by topic; empty: none
        self.arrivals = Arrivals()
        self._node = node
        self._last = last
        self._transformer = PointTransformer(session, None)
        self._delay = 0.0       # s that the last pose or transform waited in the queue
        self._transforms: transforms.Transforms | None = None
        self._subscriptions: dict[str, Subscription] = {}
        self._lost: dict[str, LostMessages] = {}
        self._probe_type = config.probe.type
        self._reference = config.reference.topic
        try:
            for topic in filter(None, [*config.probe.topics, self._reference]):
                self._receive(topic, self._type_to_receive(topic, types.get(topic, '')))
        except Exception:
            self._unsubscribe()
            raise
        self._type_timer = node.create_timer(TYPE_PERIOD, self._follow_types, clock=STEADY)
        self._timer: Timer | None = None
        back = JumpThreshold(min_forward=None, min_backward=Duration(seconds=-BACK),
                             on_clock_change=True)
        self._jumps = node.get_clock().create_jump_callback(back, post_callback=self._on_jump)
        self.configure(config)

    def activate(self) -> None:
        """Pass points on from now on."""
        self.active = True
        self.arrivals.restart()
        for subscription in self._subscriptions.values():
            self._node.get_logger().info(f'active, listening on {subscription.topic_name} '
                                         f'({type_name(subscription.msg_type)})')

    def configure(self, config: Config) -> None:
        """Apply changed settings; /tf costs time, so it is received only if it is needed."""
        self._probe_type = config.probe.type
        self._follow_types()
        needed = bool(config.points_frame) and transforms.is_available()
        if needed and self._transforms is None:
            self._transformer.set_frames(Frames())
            self._transforms = transforms.Transforms(self._node, self._on_transform)
        elif not needed and self._transforms is not None:
            self._transforms.destroy()
            self._transforms = None
            self._transformer.set_frames(None)
        # without array and /tf no point ever waits, and each check costs time
        may_wait = config.reference.topic or self._transforms is not None
        self._stop_timer()
        self._timer = self._node.create_timer(PERIOD if may_wait else IDLE_PERIOD, self._check,
                                              clock=STEADY)

    def _type_to_receive(self, topic: str, current: str) -> str:
        allowed = 'pose' if topic == self._reference else self._probe_type
        return type_to_receive(self._node, topic, allowed, current)

    def _receive(self, topic: str, kind: str) -> None:
        """Receive messages of this type, of `MESSAGES`, on a topic."""
        self.types[topic] = ''
        former = self._subscriptions.pop(topic, None)
        if former is not None:      # DDS has one type for each topic of a process
            self._lost.pop(topic).destroy()
            self._node.destroy_subscription(former)
        callback = (partial(self._on_reference_pose, kind) if topic == self._reference
                    else partial(self._on_point, topic) if kind == POINT
                    else partial(self._on_tool_pose, topic, kind))
        self._subscribe(MESSAGES[kind], topic, callback)
        self.types[topic] = kind

    def _follow_types(self) -> None:
        """Receive what is published on the topics."""
        for topic, kind in self.types.items():
            wanted = self._type_to_receive(topic, kind)
            if wanted == kind:
                continue
            try:
                self._receive(topic, wanted)
            except RCLError as error:   # the former type is still in use: try again
                self._node.get_logger().warning(f'{topic} cannot be received as {wanted} yet: '
                                                f'{error}', throttle_duration_sec=LOG_PERIOD)
                continue
            self._node.get_logger().info(f'{topic} is received as {wanted}')

    def _subscribe(self, kind: Any, topic: str,
                   callback: Callable[[Any, dict[str, Any]], None]) -> None:
        """
        Subscribe so that each callback also takes the messages that wait behind the first.

        rclpy takes one message per turn and then serves a request.  A request needs the
        latest points, and after a delay it would be answered from old ones.
        """
        def take_all(message: Any, info: dict[str, Any]) -> None:
            callback(message, info)
            # rclpy has no other way to take a message; rclpy.wait_for_message does the same
            for _ in range(MAX_BATCH):
                waiting = subscription.handle.take_message(kind, False)
                if waiting is None:
                    return
                callback(*waiting)
        on_message: Any = take_all      # rclpy accepts two arguments, but does not annotate them
        subscription = self._node.create_subscription(kind, topic, on_message, POINTS,
                                                      event_callbacks=UNWATCHED_POINTS)
        self._subscriptions[topic] = subscription
        self._lost[topic] = LostMessages(subscription)

    def destroy(self) -> None:
        """Remove subscriptions, timer and clock callback."""
        self._jumps.unregister()
        self._stop_timer()
        self._node.destroy_timer(self._type_timer)
        self._unsubscribe()
        if self._transforms is not None:
            self._transforms.destroy()

    def _unsubscribe(self) -> None:
        for lost in self._lost.values():
            lost.destroy()
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)

    def finish(self) -> None:
        """Reject the points that wait for a pose or a transform; none follows."""
        self._transformer.finish()

    def clear(self) -> None:
        """Drop waiting points, for a new session."""
        self._transformer.clear()

    @property
    def problem(self) -> str:
        """Why points were rejected in the last seconds before they reached the session."""
        age = time.monotonic() - self._transformer.last_rejection
        return self._transformer.problem if age < SHOW_FOR else ''

    def take_lost(self) -> int:
        """Return how many points of an active node were lost since the last call."""
        lost = {topic: each.take() for topic, each in self._lost.items()}
        if not self.active:
            return 0
        self.arrivals.lose([topic for topic, count in lost.items() if count])
        return sum(lost.values())

    def _on_point(self, topic: str, message: PointStamped, info: dict[str, Any]) -> None:
        arrival = self._now() - transforms.queue_delay(info)
        self._add(ros.sample_from(message, topic, arrival), arrival)

    def _on_tool_pose(self, topic: str, kind: str, message: Any, info: dict[str, Any]) -> None:
        arrival = self._now() - transforms.queue_delay(info)
        self._add(ros.tool_sample_from(message, kind, topic, arrival), arrival)

    def _add(self, sample: Sample, arrival: float) -> None:
        self._count(sample.topic, sample.stamp)
        if not self.active:
            return
        self.arrivals.add(sample.topic, sample.stamp, arrival)
        self._transformer.add_point(sample)

    def _count(self, topic: str, stamp: float) -> None:
        self._last[topic] = self._last.get(topic, (0, 0.0))[0] + 1, stamp

    def _on_transform(self, parent: str, child: str, stamp: float, T: Array, static: bool,
                      delay: float) -> None:
        self._delay = delay
        self._transformer.add_transform(parent, child, stamp, T, static)

    def _on_reference_pose(self, kind: str, message: Any, info: dict[str, Any]) -> None:
        self._delay = transforms.queue_delay(info)
        try:
            T = to_matrix(*TOOL_POSES[kind](message))
        except InputError:
            T = INVALID_TRANSFORM
        stamp = ros.stamp_to_seconds(message.header.stamp)
        self._count(self._reference, stamp)
        self._transformer.add_pose(stamp, T, message.header.frame_id)

    def _on_jump(self, jump: TimeJump) -> None:
        if not self.active:
            return
        now = self._now()
        if jump.clock_change in (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED):
            self._transformer.local_clock_replaced(now, 'use_sim_time was changed')
        else:
            self._transformer.local_clock_went_back(now - jump.delta.nanoseconds * 1e-9, now)

    def _check(self) -> None:
        # the pose that a point waits for may still be in the queue
        self._transformer.process(self._now() - self._delay)
        self._delay = 0.0
        if self.problem:
            self._node.get_logger().warning(self.problem, throttle_duration_sec=LOG_PERIOD)

    def _now(self) -> float:
        return self._node.get_clock().now().nanoseconds * 1e-9
