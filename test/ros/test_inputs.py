# SPDX-License-Identifier: Apache-2.0
"""Messages that wait in the queue are all processed before the next request."""

from __future__ import annotations

from collections.abc import Iterator

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
from gsdf_registration.session import Session
from msg_adapters import ros

pytestmark = pytest.mark.ros
MESSAGES = 300
CONFIG = Config.from_flat({'probe.topics': ['/delayed'], 'gate.max_age': 3600.0})


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    yield context
    context.try_shutdown()


def test_processes_all_waiting_messages_in_one_callback(context: Context) -> None:
    node, tracker = Node('node', context=context), Node('tracker', context=context)
    session = Session(CONFIG)
    inputs = Inputs(node, CONFIG, session)
    inputs.active = True
    publisher = tracker.create_publisher(PointStamped, '/delayed', QoSProfile(depth=MESSAGES))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def received() -> int:
        return session.status().received

    def send(number: int) -> None:
        publisher.publish(ros.point_msg([0.0, 0.0, 0.0], 'tracker', ros.seconds_to_stamp(number)))
    while not publisher.get_subscription_count():
        executor.spin_once(timeout_sec=0.01)
    stamp = 0
    while not received():       # until discovery is complete
        stamp += 1
        send(stamp)
        executor.spin_once(timeout_sec=0.1)
    before, callbacks = received(), 0
    for _ in range(MESSAGES):
        stamp += 1
        send(stamp)
    while received() < before + MESSAGES:
        executor.spin_once(timeout_sec=1.0)
        callbacks += 1
    assert callbacks < MESSAGES / 3     # a few of the messages may arrive during the first ones
    inputs.destroy()
    executor.shutdown()
