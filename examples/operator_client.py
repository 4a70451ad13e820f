# SPDX-License-Identifier: Apache-2.0
"""Wait until enough points are collected, register, and print the pose of the bone."""

import sys

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main() -> int:
    """Return 0 if the registration was accepted."""
    rclpy.init()
    node, ready, pose = Node('operator'), Future(), Future()

    def on_status(status: DiagnosticStatus) -> None:
        print(status.message)
        if any(pair.key == 'state' and pair.value == 'ready' for pair in status.values):
            ready.set_result(True)

    node.create_subscription(DiagnosticStatus, '/registration/status', on_status, LATCHED)
    rclpy.spin_until_future_complete(node, ready)
    client = node.create_client(Trigger, '/registration/register')
    client.wait_for_service()
    response = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, response)
    print(response.result().message)
    if not response.result().success:
        return 1
    node.create_subscription(PoseStamped, '/registration/bone_pose', pose.set_result, LATCHED)
    rclpy.spin_until_future_complete(node, pose)
    print(f'in frame {pose.result().header.frame_id}: {pose.result().pose}')
    return 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
