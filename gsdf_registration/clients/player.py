# SPDX-License-Identifier: Apache-2.0
"""
Play the points of a recording over ROS, for the demo and the tests.

Run it as ``python -m gsdf_registration.clients.player BAG --topic /probe/tip``. As with
``ros2 bag play``, the messages are published unchanged, with the stamps of the recording.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from msg_adapters.bag import POINT
from msg_adapters.bag_storage import BagFiles
from msg_adapters.ros import stamp_to_seconds

PATIENCE = 10.0     # s to wait for a subscriber


def main(args: Sequence[str] | None = None) -> int:
    """Play, print how much was played; return 2 if the bag is unreadable or has no subscriber."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag')
    parser.add_argument('--topic', required=True, help='topic of the bag to play')
    parser.add_argument('--as', dest='topic_out', default='',
                        help='topic to publish on (default: the topic of the bag)')
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
    messages = [raw.data for raw in BagFiles(options.bag, [POINT]).messages([options.topic])]
    if not messages:
        raise InputError(f'{options.bag} contains no points on {options.topic}')
    reliability = (ReliabilityPolicy.BEST_EFFORT
                   if options.best_effort else ReliabilityPolicy.RELIABLE)
    qos = QoSProfile(depth=len(messages), reliability=reliability)
    publisher = Node('player').create_publisher(PointStamped, options.topic_out or options.topic,
                                                qos)
    _wait_for_subscriber(publisher)
    start, first = time.monotonic(), _stamp(messages[0])
    for message in messages:
        due = start + (_stamp(message) - first) / options.rate
        time.sleep(max(0.0, due - time.monotonic()))
        publisher.publish(message)
    print(f'played {format_count(len(messages), "point")}', flush=True)
    return 0


def _wait_for_subscriber(publisher: Publisher) -> None:
    deadline = time.monotonic() + PATIENCE
    while publisher.get_subscription_count() == 0:
        if time.monotonic() > deadline:
            raise InputError(f'no node subscribes to {publisher.topic_name}')
        time.sleep(0.02)
    time.sleep(0.2)     # the subscriber discovers the publisher a little later


def _stamp(message: bytes) -> float:
    return stamp_to_seconds(deserialize_message(message, PointStamped).header.stamp)


if __name__ == '__main__':
    sys.exit(main())
