# SPDX-License-Identifier: Apache-2.0
"""What waited while the executor was held up is taken in before anything is answered."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from gsdf_registration.common.config import Config
from gsdf_registration.node.inputs import Inputs
from msg_adapters import ros

pytestmark = pytest.mark.ros
MANY = 300


class Host(Node):
    """Stands for the node, and counts what it is handed."""

    state = 'active'

    def __init__(self, context: Context) -> None:
        super().__init__('host', context=context)
        self.taken = 0

    def now(self) -> float:
        return 0.0

    def take_point(self, *_: Any) -> None:
        self.taken += 1


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    yield context
    context.try_shutdown()


def test_all_that_waits_is_taken_in_one_turn(context: Context) -> None:
    host, tracker = Host(context), Node('tracker', context=context)
    inputs = Inputs(host, Config.from_flat({'probe.topics': ['/held_up']}))  # type: ignore[arg-type]
    publisher = tracker.create_publisher(PointStamped, '/held_up', QoSProfile(depth=MANY))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(host)
    while not publisher.get_subscription_count():
        executor.spin_once(timeout_sec=0.01)

    def send(number: int) -> None:
        publisher.publish(ros.point_msg([0.0, 0.0, 0.0], 'tracker', ros.seconds_to_stamp(number)))
    while not host.taken:       # until they have found one another
        send(1)
        executor.spin_once(timeout_sec=0.1)
    before, turns = host.taken, 0
    for number in range(MANY):
        send(2 + number)
    while host.taken < before + MANY:
        executor.spin_once(timeout_sec=1.0)
        turns += 1
    assert turns < MANY / 3     # not one a turn; few may still be on their way in the first ones
    inputs.destroy()
    executor.shutdown()
