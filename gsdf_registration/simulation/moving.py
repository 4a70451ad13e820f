# SPDX-License-Identifier: Apache-2.0
"""The motion of a patient, and thus of the bone and the reference array."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gsdf_registration.common.rigid import Array, from_rt, rotation_exp


@dataclass(frozen=True)
class Sway:
    """
    A periodic motion with constant speed and constant angular velocity.

    The origin of the body moves on a circle, and its axis on a cone. If the axis is tilted by a and
    moves around the cone at w, the body rotates at 2 w sin(a/2): the angular velocity of the
    rotation vector a e with constant a is sin(a) e' + (1 - cos(a)) e x e'.

    T_tracker_body : (4, 4) float64, m, mean pose
    speed : float, m/s
    turn : float, rad/s
    radius, tilt : float, m and rad, largest deviation from the mean pose
    """

    T_tracker_body: Array = field(default_factory=lambda: np.eye(4))
    speed: float = 0.020
    turn: float = np.radians(10.0)
    radius: float = 0.03
    tilt: float = np.radians(15.0)

    def pose(self, time: float) -> Array:
        """Return ``T_tracker_body`` (4, 4), m, at ``time``, s."""
        along = self.speed / self.radius * time
        about = self.turn / (2.0 * np.sin(0.5 * self.tilt)) * time
        tilt = rotation_exp(self.tilt * np.array([np.cos(about), np.sin(about), 0.0]))
        shift = self.radius * np.array([np.cos(along), np.sin(along), 0.0])
        return self.T_tracker_body @ from_rt(tilt, shift)
