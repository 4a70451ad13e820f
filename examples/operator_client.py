# SPDX-License-Identifier: Apache-2.0
"""
Wait until enough points are collected, register, and print the pose of the bone.

It may be run again: if the bone is registered already, it prints the pose. An answer that is lost
is safe, because registering the same points again gives the same pose.
"""

import argparse
import sys
import time
from collections.abc import Callable

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TRIES = 3


class Operator(Node):
    """Follows the status and the pose of the registration node ``target``."""

    def __init__(self, target: str) -> None:
        super().__init__('operator')
        self.status: dict[str, str] = {}
        self.pose: PoseStamped | None = None
        self.create_subscription(DiagnosticStatus, f'{target}/status', self.on_status, LATCHED)
        self.create_subscription(PoseStamped, f'{target}/bone_pose', self.on_pose, LATCHED)
        self.client = self.create_client(Trigger, f'{target}/register')

    def on_status(self, message: DiagnosticStatus) -> None:
        """Print what to do next, and keep the values."""
        if message.message != self.status.get('message'):
            print(message.message, flush=True)
        self.status = {pair.key: pair.value for pair in message.values}
        self.status['message'] = message.message

    def on_pose(self, message: PoseStamped) -> None:
        """Keep the pose of the bone."""
        self.pose = message

    def wait(self, condition: Callable[[], bool], limit: float = float('inf')) -> bool:
        """Process messages until the condition holds; return False after ``limit`` seconds."""
        end = time.monotonic() + limit
        while not condition() and time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=0.1)
            if not rclpy.ok():
                raise ExternalShutdownException
        return condition()

    def is_registered(self) -> bool:
        """Return whether there is a pose."""
        return self.status.get('pose', 'none') != 'none'

    def is_ready(self) -> bool:
        """Return whether the node asks for a registration."""
        return self.status.get('state') == 'ready'

    def register(self, limit: float) -> bool:
        """Register; repeat the request if no answer comes and the status does not change."""
        self.wait(self.client.service_is_ready, limit)
        for _ in range(TRIES):
            answer = self.client.call_async(Trigger.Request())
            if self.wait(lambda answer=answer: answer.done() or self.status['state'] in (
                    'registered', 'refused'), limit):
                if answer.done():
                    print(answer.result().message)
                    return bool(answer.result().success)
                return self.status['state'] == 'registered'
            print(f'no answer within {limit:g} s', file=sys.stderr)
        return False


def main() -> int:
    """Return 0 if the bone is registered."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('node', nargs='?', default='/registration')
    parser.add_argument('--limit', type=float, default=20.0, help='time to wait for an answer, s')
    options = parser.parse_args(rclpy.utilities.remove_ros_args()[1:])
    rclpy.init()
    operator = Operator(options.node)
    if not operator.wait(lambda: bool(operator.status), options.limit):
        print(f'no node {options.node} within {options.limit:g} s: is it started, and in this ROS '
              'domain?', file=sys.stderr)
        return 1
    operator.wait(lambda: operator.is_ready() or operator.is_registered())
    if operator.is_ready() and not operator.register(options.limit):
        return 1
    if not operator.wait(lambda: operator.pose is not None, options.limit):
        print(f'no pose on {options.node}/bone_pose', file=sys.stderr)
        return 1
    print(f'in frame {operator.pose.header.frame_id}: {operator.pose.pose}')
    return 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception:
        if rclpy.ok():      # else a signal has shut rclpy down, perhaps in the middle of a call
            raise
        sys.exit(130)
