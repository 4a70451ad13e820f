# SPDX-License-Identifier: Apache-2.0
"""The rigid motion of a pose message, whichever library the message is of."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, from_rt, rotation_from_quaternion

# stands for what a message says where it says no motion, for who carries the points to count
NO_MOTION = np.full((4, 4), np.nan)
UNIT = 0.01     # a quaternion's length may be off by so much, as tf2 allows


def motion_from(position: Any, orientation: Any) -> Array:
    """
    Return the motion (4, 4) of a position with x, y, z, m, and a quaternion with x, y, z, w.

    Raises
    ------
    InputError
        When it is none: not finite, or the quaternion not of unit length.

    """
    t = [position.x, position.y, position.z]
    q = [orientation.x, orientation.y, orientation.z, orientation.w]
    if not np.isfinite(t).all():
        raise InputError(f'a pose has the position {t}, which is not finite')
    if not abs(np.linalg.norm(q) - 1.0) <= UNIT:    # NaN is not either
        raise InputError(f'a pose has no orientation: its quaternion {q} is not of unit length')
    return from_rt(rotation_from_quaternion(q), t)
