# SPDX-License-Identifier: Apache-2.0
"""
Record live topics into a rosbag2 (mcap), for ``gsdf record``, without rosbag2_py.

The messages are not decoded. They are written to the disk once a second, so that a recorder that is
killed loses no more than the last second.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from msg_adapters.bag_writer import BagWriter
from msg_adapters.ros_definitions import definition_of, message_class
from msg_adapters.ros_lost_messages import LostMessages

FLUSH = 1.0         # s between two writes to the disk
LOOK = 0.2          # s between two looks for topics
DEPTH = 10_000      # messages; of a queue of more than 5000 Fast DDS counts what it loses
PATTERN = frozenset('*?[')      # characters of a topic that is a pattern


class Recorder:
    """
    Writes the messages of topics to a bag, from the moment when each is published.

    Parameters
    ----------
    node : Node
    bag : BagWriter
    topics : sequence of str
        Names, or patterns such as ``/registration/*``.

    Attributes
    ----------
    lost : dict of str to int
        Number of messages of each topic that were lost on the way.

    """

    def __init__(self, node: Node, bag: BagWriter, topics: Sequence[str]) -> None:
        self.lost: dict[str, int] = {}
        self._node, self._bag, self._topics = node, bag, topics
        self._subscriptions: dict[str, tuple[Subscription, LostMessages]] = {}
        self._unmatched: dict[str, str] = {}    # type of each topic that is not received yet
        self._refused: set[str] = set()
        self._looked = self._flushed = -LOOK

    @property
    def missing(self) -> list[str]:
        """The topics that nobody has published yet."""
        return [topic for topic in self._topics
                if not any(fnmatchcase(name, topic) for name in self._subscriptions)]

    def step(self, timeout: float) -> None:
        """Receive messages for a moment, look for topics, and write to the disk once a second."""
        now = time.monotonic()
        if now - self._looked >= LOOK:
            self._looked = now
            self._look()
        if now - self._flushed >= FLUSH:
            self._flushed = now
            self._bag.flush()
        rclpy.spin_once(self._node, timeout_sec=timeout)
        self._take_waiting()

    def finish(self) -> None:
        """Write what was received until now, count what was lost, and stop receiving."""
        self._take_waiting()
        for topic, (subscription, lost) in self._subscriptions.items():
            self.lost[topic] = lost.take()
            lost.destroy()
            self._node.destroy_subscription(subscription)

    def _look(self) -> None:
        """Subscribe to the topics that are published now; report those that are received."""
        for name, _ in self._node.get_topic_names_and_types():
            if (name not in self._subscriptions and name not in self._refused
                    and any(fnmatchcase(name, topic) for topic in self._topics)):
                publishers = self._node.get_publishers_info_by_topic(name)
                if publishers:
                    self._subscribe(name, publishers)
        for name, kind in list(self._unmatched.items()):
            if self._subscriptions[name][0].get_publisher_count():
                del self._unmatched[name]
                print(f'recording {name} ({kind})', flush=True)

    def _subscribe(self, name: str, publishers: list[TopicEndpointInfo]) -> None:
        kind = publishers[0].topic_type
        try:
            message, definition = message_class(kind), definition_of(kind)
        except InputError as error:
            if not PATTERN & set(''.join(self._topics)):
                raise
            self._refused.add(name)
            print(f'{name} is left out: {error.message}', file=sys.stderr, flush=True)
            return
        self._bag.add_topic(name, kind, definition)
        callback: Any = partial(self._on_message, name)
        subscription = self._node.create_subscription(
            message, name, callback, _profile(publishers), raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
        self._subscriptions[name] = subscription, LostMessages(subscription)
        self._unmatched[name] = kind

    def _take_waiting(self) -> None:
        """
        Write the messages that wait in the queues, up to those received now.

        rclpy serves one message per turn, which is too slow for a busy computer; see also
        `node.inputs`.
        """
        now = time.time_ns()
        for topic, (subscription, _) in self._subscriptions.items():
            while True:
                waiting = subscription.handle.take_message(subscription.msg_type, True)
                if waiting is None:
                    break
                self._on_message(topic, *waiting)
                if waiting[1]['received_timestamp'] > now:
                    break

    def _on_message(self, topic: str, data: bytes, info: dict[str, Any]) -> None:
        # the middleware's time: topics keep their order although messages wait in their queues
        self._bag.write(topic, info['received_timestamp'] or time.time_ns(), data)


def _profile(publishers: list[TopicEndpointInfo]) -> QoSProfile:
    """Return a profile that all publishers match, and that misses as little as they permit."""
    reliable = all(info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                   for info in publishers)
    latched = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                  for info in publishers)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def run(topics: Sequence[str], path: str, duration: float | None = None) -> int:
    """
    Record until a signal comes; return 1 if nothing was received.

    Parameters
    ----------
    topics : see `Recorder`
    path : of the bag
    duration : s, after which the recording ends; None: at a signal only

    """
    stopped = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, stop)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node('recorder')
        with BagWriter(path, keep=True) as bag:
            recorder = Recorder(node, bag, topics)
            end = None if duration is None else time.monotonic() + duration
            while not stopped and (end is None or time.monotonic() < end):
                recorder.step(0.1)
            recorder.finish()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    return report(recorder, bag.counts, Path(path))


def report(recorder: Recorder, counts: dict[str, int], path: Path) -> int:
    """Print what was recorded, lost and missing; return the exit code of `run`."""
    for topic, count in counts.items():
        lost = recorder.lost.get(topic, 0)
        print(f'{topic}: {format_count(count, "message")}' + (
            f'; {lost} lost' if lost else ''))
    for topic in recorder.missing:
        print(f'{topic}: nobody published it', file=sys.stderr)
    lost = sum(recorder.lost.values())
    if lost:
        print(f'{format_count(lost, "message")} lost before they could be recorded: the computer '
              'or the network is overloaded, or a publisher keeps only its last message',
              file=sys.stderr)
    print(f'written to {path}', flush=True)
    return 0 if sum(counts.values()) else 1
