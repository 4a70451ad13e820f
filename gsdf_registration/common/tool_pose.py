# SPDX-License-Identifier: Apache-2.0
"""
The pose of a tracked tool as seven numbers, and the position of its tip.

A tracker measures the pose of a tool: the position ``x y z``, m, of the origin of the tool, and its
orientation as a unit quaternion ``qx qy qz qw``.  The tip has a fixed position in the frame of the
tool, see `gsdf_registration.tracking.pivot`.  One formula serves single poses and arrays, so that a
tip that is calibrated later gives the same positions to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsdf_registration.common.rigid import Array, quaternion_from_rotation, transform

ToolPose = tuple[float, float, float, float, float, float, float]

TIP_UNKNOWN = ('probe.tip is not set: calibrate the tip (~/calibrate_tip or gsdf pivot) or set '
               'probe.tip (--tip); set it to 0 0 0 if the poses are those of the tip')
NOT_UNIT = 1e-3     # a quaternion whose length differs by more from 1 is no orientation


def is_valid(tool: ToolPose) -> bool:
    """Return whether the orientation of a tool is a unit quaternion; NaN is none."""
    return abs(math.hypot(*tool[3:]) - 1.0) <= NOT_UNIT


def normalized(tool: ToolPose) -> ToolPose:
    """Return a valid pose with a quaternion of length 1."""
    x, y, z, qx, qy, qz, qw = tool
    length = math.hypot(qx, qy, qz, qw)
    return x, y, z, qx / length, qy / length, qz / length, qw / length


def moved(T: Array, tool: ToolPose) -> ToolPose:
    """Return a pose in frame a from that in frame b; ``T`` is ``T_a_b`` (4, 4), m."""
    x, y, z = transform(T, tool[:3]).tolist()
    ax, ay, az, aw = quaternion_from_rotation(T[:3, :3]).tolist()
    bx, by, bz, bw = tool[3:]
    return (x, y, z, aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def mean_pose(tools: Sequence[ToolPose]) -> ToolPose:
    """Return the mean of one or more poses that are near to one another."""
    poses = np.array(tools)
    poses[:, 3:] *= np.where(poses[:, 3:] @ poses[0, 3:] < 0.0, -1.0, 1.0)[:, None]
    x, y, z, qx, qy, qz, qw = poses.mean(axis=0).tolist()
    return normalized((x, y, z, qx, qy, qz, qw))


def tip_position(tool: ToolPose, tip: Sequence[float]) -> tuple[float, float, float]:
    """
    Return the position of the tip in the frame of a pose, m.

    Parameters
    ----------
    tool : of 7 float, with a unit quaternion
    tip : (3,) float, m, in the frame of the tool; empty: the origin of the tool

    """
    x, y, z = _tip(*tool, *(tip or (0.0, 0.0, 0.0)))
    return x, y, z


def tip_positions(tools: Array, tip: Sequence[float]) -> Array:
    """Return the positions of the tip (n, 3), m, for poses (n, 7); NaN where the pose is NaN."""
    return np.stack(_tip(*tools.T, *(tip or (0.0, 0.0, 0.0))), axis=1)


def _tip(x: Any, y: Any, z: Any, qx: Any, qy: Any, qz: Any, qw: Any, tx: float, ty: float,
         tz: float) -> tuple[Any, Any, Any]:
    """Return ``p + t + 2 w (q x t) + 2 q x (q x t)`` for numbers or arrays of numbers."""
    cx, cy, cz = (2.0 * (qy * tz - qz * ty), 2.0 * (qz * tx - qx * tz), 2.0 * (qx * ty - qy * tx))
    return (x + tx + (qw * cx + (qy * cz - qz * cy)), y + ty + (qw * cy + (qz * cx - qx * cz)),
            z + tz + (qw * cz + (qx * cy - qy * cx)))
