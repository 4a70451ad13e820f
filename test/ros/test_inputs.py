# SPDX-License-Identifier: Apache-2.0
"""Messages that wait in the queue are all processed before the next request, or counted as lost."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest
import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier
from waiting import until

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
    inputs = Inputs(node, CONFIG, session, {})
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
    node.destroy_node()
    tracker.destroy_node()


BURST = 6000    # more than the queue holds
SENDER = f"""
import itertools
import sys
import time
import rclpy
from geometry_msgs.msg import PointStamped
from msg_adapters import ros
rclpy.init()
publisher = rclpy.create_node('tracker').create_publisher(PointStamped, '/delayed', 100)
while not publisher.get_subscription_count():
    pass
sys.stdin.readline()
for stamp in itertools.count():
    publisher.publish(ros.point_msg([1e-3 * (stamp % 9), 0.0, 0.0], 'tracker',
                                    ros.seconds_to_stamp(stamp)))
    if stamp == {BURST}:
        print('sent', flush=True)
    if stamp >= {BURST}:
        time.sleep(0.01)
"""


@pytest.mark.skipif(get_rmw_implementation_identifier() != 'rmw_fastrtps_cpp',
                    reason='other middleware may count in another way')
def test_counts_the_messages_that_did_not_fit_into_the_queue(context: Context) -> None:
    node, session = Node('node', context=context), Session(CONFIG)
    inputs = Inputs(node, CONFIG, session, {})
    inputs.activate()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    subscription, = (each for each in node.subscriptions if each.topic_name == '/delayed')
    with subprocess.Popen([sys.executable, '-c', SENDER], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE) as sender:
        # what is sent before this side has discovered the sender does not count as lost
        until(lambda: subscription.get_publisher_count() > 0)
        assert sender.stdin is not None and sender.stdout is not None
        sender.stdin.write(b'\n')
        sender.stdin.flush()
        assert sender.stdout.readline() == b'sent\n'
        lost = 0
        while session.points().stamps[-1:].sum() <= BURST:
            executor.spin_once(timeout_sec=0.1)
            lost += inputs.take_lost()
        sender.kill()
    last = session.points().stamps[-1]
    assert session.status().received + lost == last + 1
    assert 'messages on /delayed were lost' in inputs.arrivals.hints()[0].sentence
    inputs.destroy()
    executor.shutdown()
    node.destroy_node()
