# SPDX-License-Identifier: Apache-2.0
"""A patient who moves, and with him the bone and the reference array fixed to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gsdf_registration.common.rigid import Array, from_rt, rotation_exp


@dataclass(frozen=True)
class Sway:
    """
    A body that moves at constant speed and turns at constant rate, and yet stays in view.

    Its origin goes round a circle while its axis goes round a cone.  An axis that is tilted by a
    and goes round at w turns the body at 2 w sin(a/2), for the rotation vector a e has the angular
    velocity sin(a) e' + (1 - cos(a)) e x e' where its direction e moves at e' and a is constant.

    T_tracker_body : (4, 4) float64, m, where it is on average
    speed : m/s
    turn : rad/s
    radius, tilt : m, rad, how far it gets from there
    """

    T_tracker_body: Array = field(default_factory=lambda: np.eye(4))
    speed: float = 0.020
    turn: float = np.radians(10.0)
    radius: float = 0.03
    tilt: float = np.radians(15.0)

    def pose(self, time: float) -> Array:
        """Return ``T_tracker_body`` (4, 4), m, at a time, s."""
        along = self.speed / self.radius * time
        about = self.turn / (2.0 * np.sin(0.5 * self.tilt)) * time
        tilt = rotation_exp(self.tilt * np.array([np.cos(about), np.sin(about), 0.0]))
        shift = self.radius * np.array([np.cos(along), np.sin(along), 0.0])
        return self.T_tracker_body @ from_rt(tilt, shift)
