# SPDX-License-Identifier: Apache-2.0
"""Attitudes to start a search from: spread over all rotations, or round a first guess."""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration import rigid
from gsdf_registration.rigid import Array


def super_fibonacci(count: int) -> Array:
    """Return ``count`` rotations (count, 3, 3) spread evenly over SO(3) (Alexa, CVPR 2022)."""
    phi, psi = math.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, q = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    quaternions = np.stack(
        [r * np.sin(alpha), r * np.cos(alpha), q * np.sin(beta), q * np.cos(beta)], axis=1)
    return np.array([rigid.rotation_from_quaternion(x) for x in quaternions])


def around(T_bone_points: Array) -> tuple[Array, Array]:
    """
    Return starts (m, 3, 3), (m, 3) turned about the centroid, at the origin, up to 30 degrees.

    The guess itself comes first.
    """
    axes = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)],
                    dtype=np.float64)
    axes = axes[np.abs(axes).sum(axis=1) > 0]
    turns = [np.zeros(3)] + [
        math.radians(angle) * a / np.linalg.norm(a) for angle in (10.0, 20.0, 30.0) for a in axes
    ]
    R = np.array([rigid.rotation_exp(turn) @ T_bone_points[:3, :3] for turn in turns])
    return R, np.tile(T_bone_points[:3, 3], (len(R), 1))
