# SPDX-License-Identifier: Apache-2.0
"""Sets of candidate poses: where the search starts, and which poses are distinct."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.rigid import Array


class Poses(NamedTuple):
    """
    Poses T_bone_points = (R, t) of points relative to some origin, which is mapped to t.

    R : (m, 3, 3) float64
    t : (m, 3) float64, metres
    """

    R: Array
    t: Array

    def select(self, which: NDArray[np.int64]) -> Poses:
        """Return a copy of the poses with these indices."""
        return Poses(self.R[which], self.t[which])

    def with_origin(self, origin: Array) -> Poses:
        """Return the same poses for points relative to another origin (3,), m from the old one."""
        return Poses(self.R, self.t + self.R @ origin)

    @staticmethod
    def concatenated(poses: Sequence[Poses]) -> Poses:
        """Return the poses of several sets, in order."""
        return Poses(np.concatenate([p.R for p in poses]), np.concatenate([p.t for p in poses]))


def super_fibonacci(count: int) -> Array:
    """Return rotations (count, 3, 3) distributed evenly over SO(3) (Alexa, CVPR 2022)."""
    phi, psi = math.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, q = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    quaternions = np.stack(
        [r * np.sin(alpha), r * np.cos(alpha), q * np.sin(beta), q * np.cos(beta)], axis=1)
    return np.array([rigid.rotation_from_quaternion(x) for x in quaternions])


def rotated_starts(T_bone_points: Array) -> Poses:
    """Return a pose, and the pose rotated about the origin of the points by 10, 20, 30 degrees."""
    axes = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)],
                    dtype=np.float64)
    axes = axes[np.abs(axes).sum(axis=1) > 0]
    vectors = [np.zeros(3)] + [
        math.radians(angle) * a / np.linalg.norm(a) for angle in (10.0, 20.0, 30.0) for a in axes
    ]
    R = np.array([rigid.rotation_exp(v) @ T_bone_points[:3, :3] for v in vectors])
    return Poses(R, np.tile(T_bone_points[:3, 3], (len(R), 1)))


def distinct(R: Array, t: Array, points: Array, separation: float, count: int) -> NDArray[np.int64]:
    """
    Return the indices of the first ``count`` distinct poses.

    Two poses are distinct if they move the points at least ``separation`` (RMS) apart.

    Parameters
    ----------
    R, t : (m, 3, 3) and (m, 3) float64, m, as in `Poses`
    points : (n, 3) float64, m, about their centroid, which is mapped to t
    separation : float, m

    """
    # the RMS distance of two poses is a Euclidean distance between vectors made from (R, t)
    _, spread, axes = np.linalg.svd(points, full_matrices=False)
    turned = R @ (axes.T * spread / math.sqrt(len(points)))
    return _distinct(np.concatenate([turned.reshape(len(turned), -1), t], axis=1), separation**2,
                     count)


@compiled
def _distinct(x: Array, separation2: float, count: int) -> NDArray[np.int64]:
    """Return indices of the first ``count`` rows of ``x`` that are sqrt(separation2) apart."""
    chosen = np.zeros(min(count, len(x)), np.int64)
    m = 0
    for i in range(len(x)):
        new = True
        for j in range(m):
            squared = 0.0
            for a in range(x.shape[1]):
                squared += (x[i, a] - x[chosen[j], a]) ** 2
            if squared < separation2:
                new = False
                break
        if new:
            chosen[m] = i
            m += 1
            if m == len(chosen):
                break
    return chosen[:m]
