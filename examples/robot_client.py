# SPDX-License-Identifier: Apache-2.0
"""
Use the pose of a bone only while it is valid, and accurate enough at the targets of the robot.

Replace `Robot.start` and `Robot.stop` by your own motion. cpp/robot_client.cpp is the same in C++.
"""

import argparse
import sys

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile

from gsdf_registration_msgs.msg import RegistrationResult

# The lease: a node that was killed is noticed within 3 s
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL,
                     liveliness=LivelinessPolicy.AUTOMATIC,
                     liveliness_lease_duration=Duration(seconds=3.0))
PERIOD = 0.1        # s between two looks at the publishers
PATIENCE = 10.0     # s without a publisher after which the client says so


def problem(result: RegistrationResult, max_tre: float, grades: str) -> str:
    """Return why the pose must not be used; empty if it may be used."""
    if not result.valid:
        return str(result.message)
    if not result.grade or result.grade not in grades:
        return f'grade "{result.grade}", and {" or ".join(grades)} is required'
    # without targets, the maximum over the bone
    errors = dict(zip(result.target_names, result.target_tre)) or {'the bone': result.tre_max}
    for target, error in errors.items():
        if not error <= max_tre:        # an unknown error is NaN
            return (f'predicted error {1e3 * error:.2f} mm at {target}, and {1e3 * max_tre:.2f} mm '
                    'is allowed')
    return ''


class Robot(Node):
    """Follows the result of the registration node ``target``."""

    def __init__(self, target: str, max_tre: float, grades: str) -> None:
        super().__init__('robot')
        self.topic, self.max_tre, self.grades = f'{target}/result', max_tre, grades
        self.moving = False
        self.missing = 0        # looks without a publisher
        self.create_subscription(
            RegistrationResult, self.topic, self.on_result, LATCHED,
            event_callbacks=SubscriptionEventCallbacks(liveliness=self.on_liveliness))
        self.create_timer(PERIOD, self.check_publisher)

    def on_result(self, result: RegistrationResult) -> None:
        """Stop at every new result, and start again if its pose may be used."""
        reason = problem(result, self.max_tre, self.grades)
        self.stop(reason or 'the bone was registered again')
        if reason:
            print(f'waiting: {reason}', flush=True)
        else:
            self.start(result)

    def on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        """Stop when the node is gone: a process that is killed withdraws nothing."""
        if event.alive_count == 0:
            self.stop('the registration node is gone')

    def check_publisher(self) -> None:
        """Stop, and after a while say so, if there is no node."""
        self.missing = 0 if self.count_publishers(self.topic) else self.missing + 1
        if self.missing:
            self.stop('the registration node is gone')
        if self.missing == round(PATIENCE / PERIOD):
            print(f'nobody publishes {self.topic}: is the node started, in this ROS domain, and '
                  'was it built with gsdf_registration_msgs?', file=sys.stderr)

    def start(self, result: RegistrationResult) -> None:
        """Start to move relative to the bone."""
        self.moving = True
        place = result.pose.pose.position
        print(f'start: registration {result.registration_id}, bone at {place.x:.4f}, '
              f'{place.y:.4f}, {place.z:.4f} m in {result.header.frame_id}', flush=True)

    def stop(self, reason: str) -> None:
        """Stop the motion, if there is one."""
        if self.moving:
            self.moving = False
            print(f'stop: {reason}', flush=True)


def main() -> int:
    """Run until a signal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('node', nargs='?', default='/registration')
    parser.add_argument('--max-tre', type=float, default=0.001,
                        help='largest predicted error at a target, m')
    parser.add_argument('--grades', default='AB', help='grades that are good enough')
    options = parser.parse_args(rclpy.utilities.remove_ros_args()[1:])
    rclpy.init()
    robot = Robot(options.node, options.max_tre, options.grades)
    print(f'waiting for {robot.topic}', flush=True)
    try:
        rclpy.spin(robot)
    except KeyboardInterrupt:
        pass
    except Exception:
        if rclpy.ok():      # else a signal has shut rclpy down, perhaps in the middle of a call
            raise
    finally:
        robot.stop('the client ends')
    return 0


if __name__ == '__main__':
    sys.exit(main())
