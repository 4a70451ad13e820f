# SPDX-License-Identifier: Apache-2.0
"""A process that publishes a latched RegistrationResult and serves Register, for test_messages."""

from __future__ import annotations

import numpy as np
import rclpy

from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.node.qos import LATCHED
from gsdf_registration_msgs.msg import RegistrationResult as ResultMessage
from gsdf_registration_msgs.srv import Register
from msg_adapters import results, ros


def main() -> None:
    rclpy.init()
    node = rclpy.create_node('result_server')
    header = results.ResultHeader(ros.seconds_to_stamp(12.25), 'tracker', 'hip', 'a1b2', 1)
    accepted = RegistrationResult(Reason.CONVERGED, 'registered', np.eye(4), np.eye(6),
                                  predicted_tre_m={'cup': 6e-4, 'rms': 5e-4, 'max': 9e-4})
    publisher = node.create_publisher(ResultMessage, '~/result', LATCHED)

    def register(request: Register.Request, response: Register.Response) -> Register.Response:
        """Withdraw the pose, and return the initial pose that was received."""
        response.success, response.message = request.use_initial_pose, 'registered'
        response.result = results.result_msg(accepted, header)
        response.result.pose.pose = request.initial_pose.pose
        publisher.publish(results.withdrawal_msg(Withdrawal.CLEARED, 'cleared', header))
        return response

    node.create_service(Register, '~/register_with', register)
    publisher.publish(results.result_msg(accepted, header))
    rclpy.spin(node)


if __name__ == '__main__':
    main()
