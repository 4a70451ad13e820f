# SPDX-License-Identifier: Apache-2.0
"""Convert a pose message of any library to a matrix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, from_rt, rotation_from_quaternion
from gsdf_registration.common.tool_pose import ToolPose

# Placeholder for a message that is not a rigid motion; points that need it are rejected
INVALID_TRANSFORM = np.full((4, 4), np.nan)
TOLERANCE = 0.01    # of the length of a quaternion, as in tf2

# columns of a table with the poses of a tool
POSITION = ('tx', 'ty', 'tz')
ORIENTATION = ('qx', 'qy', 'qz', 'qw')

POINT = 'geometry_msgs/msg/PointStamped'
POSE = 'geometry_msgs/msg/PoseStamped'
# position and orientation in the messages that carry the pose of a tool, by type
TOOL_POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    POSE: lambda message: (message.pose.position, message.pose.orientation),
    'geometry_msgs/msg/PoseWithCovarianceStamped': lambda message: (
        message.pose.pose.position, message.pose.pose.orientation),
    'geometry_msgs/msg/TransformStamped': lambda message: (message.transform.translation,
                                                           message.transform.rotation),
}


def tool_pose(message: Any, kind: str) -> ToolPose:
    """Return the pose in a message of a type of `TOOL_POSES`; it may be invalid."""
    position, turn = TOOL_POSES[kind](message)
    return position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w


def to_matrix(position: Any, orientation: Any) -> Array:
    """
    Return the matrix (4, 4) of a position with x, y, z, m, and a quaternion with x, y, z, w.

    Raises
    ------
    InputError
        If a value is not finite or the quaternion does not have unit length.

    """
    t = [position.x, position.y, position.z]
    q = [orientation.x, orientation.y, orientation.z, orientation.w]
    if not np.isfinite(t).all():
        raise InputError(f'a pose has a position that is not finite: {t}')
    if not abs(np.linalg.norm(q) - 1.0) <= TOLERANCE:   # false for NaN
        raise InputError(f'a pose has no valid orientation: its quaternion {q} does not have unit '
                         'length')
    return from_rt(rotation_from_quaternion(q), t)
