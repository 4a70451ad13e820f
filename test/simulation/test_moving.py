# SPDX-License-Identifier: Apache-2.0
"""Test the speed and the range of the simulated patient motion."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import angle_between, exp, is_rigid
from gsdf_registration.simulation.moving import Sway


def test_speed_and_angular_velocity_are_constant() -> None:
    sway = Sway(exp([0.4, -1.0, 0.3, 0.1, 0.2, -1.2]), 0.020, np.radians(10.0))
    step = 1e-3
    for time in np.linspace(0.0, 60.0, 50):
        a, b = sway.pose(time), sway.pose(time + step)
        assert is_rigid(a)
        assert np.isclose(np.linalg.norm(b[:3, 3] - a[:3, 3]) / step, 0.020, rtol=1e-5)
        turn = angle_between(a[:3, :3], b[:3, :3]) / step
        assert np.isclose(turn, np.radians(10.0), rtol=1e-5)


def test_pose_stays_near_the_mean_pose() -> None:
    sway = Sway(radius=0.03)
    poses = np.array([sway.pose(time) for time in np.linspace(0.0, 300.0, 500)])
    assert np.linalg.norm(poses[:, :3, 3], axis=1).max() < 0.0301
    assert poses[:, 2, 2].min() > np.cos(np.radians(15.1))
