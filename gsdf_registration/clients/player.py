# SPDX-License-Identifier: Apache-2.0
"""
Play positions and poses of a recording over ROS, for the demo and the tests.

Run it as ``python -m gsdf_registration.clients.player BAG --topic /probe/tip``. As with
``ros2 bag play``, the messages are published unchanged, with the stamps of the recording. Each is
due at its own stamp, so several topics keep their timing relative to each other.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from msg_adapters.bag_storage import BagFiles, Raw
from msg_adapters.motion import POINT, TOOL_POSES
from msg_adapters.ros import stamp_to_seconds
from msg_adapters.ros_definitions import message_class

PATIENCE = 10.0     # s to wait for a subscriber


def main(args: Sequence[str] | None = None) -> int:
    """Play, print how much was played; return 2 if the bag is unreadable or has no subscriber."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag')
    parser.add_argument('--topic', required=True, action='append', dest='topics',
                        help='topic of the bag to play: PointStamped, PoseStamped, '
                        'PoseWithCovarianceStamped or TransformStamped; may be repeated')
    parser.add_argument('--as', action='append', dest='names', default=[],
                        help='topic to publish on, one for each --topic (default: the topics of '
                        'the bag)')
    parser.add_argument('--rate', type=float, default=1.0,
                        help='speed relative to the recording (default: 1)')
    parser.add_argument('--best-effort', action='store_true',
                        help='publish with best effort, as most trackers do')
    options = parser.parse_args(args)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        return _play(options)
    except InputError as error:
        print(f'player: {error.message}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    finally:
        rclpy.try_shutdown()


def _play(options: argparse.Namespace) -> int:
    names = dict(zip(options.topics, options.names or options.topics))
    if len(options.names) not in (0, len(options.topics)):
        raise InputError('give --as once for each --topic, or not at all')
    messages = sorted((_stamp(raw), order, raw)
                      for order, raw in enumerate(_messages(options.bag, options.topics)))
    reliability = (ReliabilityPolicy.BEST_EFFORT
                   if options.best_effort else ReliabilityPolicy.RELIABLE)
    qos = QoSProfile(depth=len(messages), reliability=reliability)
    node, types = Node('player'), {raw.topic: raw.msgtype for _, _, raw in messages}
    publishers = {topic: node.create_publisher(message_class(types[topic]), name, qos)
                  for topic, name in names.items()}
    _wait_for_subscribers(list(publishers.values()))
    start, first = time.monotonic(), messages[0][0]
    for stamp, _, raw in messages:
        due = start + (stamp - first) / options.rate
        time.sleep(max(0.0, due - time.monotonic()))
        publishers[raw.topic].publish(raw.data)
    print(f'played {format_count(len(messages), "message")}', flush=True)
    return 0


def _messages(bag: str, topics: list[str]) -> list[Raw]:
    """Return the messages of all topics; raise `InputError` if a topic has none to play."""
    messages = [raw for raw in BagFiles(bag).messages(topics)
                if raw.msgtype == POINT or raw.msgtype in TOOL_POSES]
    silent = sorted({*topics} - {raw.topic for raw in messages})
    if silent:
        raise InputError(f'{bag} contains no positions or poses on {", ".join(silent)}')
    return messages


def _wait_for_subscribers(publishers: list[Publisher]) -> None:
    deadline = time.monotonic() + PATIENCE
    while silent := [each for each in publishers if each.get_subscription_count() == 0]:
        if time.monotonic() > deadline:
            raise InputError(f'no node subscribes to {silent[0].topic_name}')
        time.sleep(0.02)
    time.sleep(0.2)     # the subscribers discover the publishers a little later


def _stamp(raw: Raw) -> float:
    return stamp_to_seconds(deserialize_message(raw.data, message_class(raw.msgtype)).header.stamp)


if __name__ == '__main__':
    sys.exit(main())
