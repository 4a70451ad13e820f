# SPDX-License-Identifier: Apache-2.0
"""Messages for recordings: the same bytes with ROS and without it."""

from __future__ import annotations

import ast
import subprocess
import sys

import numpy as np
import pytest
from test_without_ros import WITHOUT_ROS

from gsdf_registration.common.rigid import exp
from msg_adapters import messages, results, ros
from msg_adapters.bag import TYPES

# prints the bytes of one message of each kind
MADE = """
import numpy as np
from gsdf_registration.common.rigid import exp
from msg_adapters import messages, ros
T, stamp = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0]), ros.seconds_to_stamp(12.5)
status = ros.diagnostic_status('/registration', messages.DiagnosticStatus.WARN, 'a', {'b': 1})
made = [
    ros.point_msg([1.0, 2.0, 3.0], 'tracker', stamp), ros.pose_msg(T, 'tracker', stamp),
    ros.pose_with_covariance_msg(T, np.eye(6), 'tracker', stamp), ros.with_stamp(status, stamp),
    messages.tf_message([ros.transform_msg(T, 'tracker', 'bone', stamp)]),
    ros.cloud_msg(np.ones((2, 3)), [1.0, 2.0], 0.5, [1, 2], 'bone', stamp),
    messages.DiagnosticArray(header=messages.Header(stamp=stamp, frame_id=''), status=[status])]
print([(messages.type_of(each), messages.serialized(each)) for each in made])
"""


def made(code: str) -> list[tuple[str, bytes]]:
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    found: list[tuple[str, bytes]] = ast.literal_eval(done.stdout)
    return found


def test_messages_are_the_same_without_ros() -> None:
    pytest.importorskip('rclpy')
    found = made(WITHOUT_ROS + MADE)
    assert found == made(MADE) and len(found) == 7
    for kind, data in found:
        assert bytes(TYPES.serialize_cdr(TYPES.deserialize_cdr(data, kind), kind)) == data


def test_a_message_can_be_read_back() -> None:
    T = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
    message = messages.tf_message([ros.transform_msg(T, 'tracker', 'bone',
                                                     ros.seconds_to_stamp(12.5))])
    assert messages.type_of(message) == 'tf2_msgs/msg/TFMessage'
    read, = TYPES.deserialize_cdr(messages.serialized(message), 'tf2_msgs/msg/TFMessage').transforms
    stamp, T_read, parent, child = ros.transform_from(read)
    assert (stamp, parent, child) == (12.5, 'tracker', 'bone')
    assert np.allclose(T_read, T, atol=1e-12)


def test_only_types_that_are_not_standard_need_a_definition() -> None:
    assert messages.definition('geometry_msgs/msg/PoseStamped') == ''
    if results.available():
        assert 'string sentence' in messages.definition('gsdf_registration_msgs/msg/Guidance')
