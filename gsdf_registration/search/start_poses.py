# SPDX-License-Identifier: Apache-2.0
"""Candidate poses of a search: where to start, and which of them are distinct."""

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
    Poses T_bone_points = (R, t) of points taken about some centre, which comes to t.

    R : (m, 3, 3) float64
    t : (m, 3) float64, metres
    """

    R: Array
    t: Array

    def pick(self, which: NDArray[np.int64]) -> Poses:
        """Return some of them, copied."""
        return Poses(self.R[which], self.t[which])

    def about(self, centre: Array) -> Poses:
        """Return them for points about another ``centre`` (3,), m, from the old one."""
        return Poses(self.R, self.t + self.R @ centre)

    @staticmethod
    def joined(poses: Sequence[Poses]) -> Poses:
        """Return all of several, in order."""
        return Poses(np.concatenate([p.R for p in poses]), np.concatenate([p.t for p in poses]))


def super_fibonacci(count: int) -> Array:
    """Return ``count`` rotations (count, 3, 3) spread evenly over SO(3) (Alexa, CVPR 2022)."""
    phi, psi = math.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, q = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    quaternions = np.stack(
        [r * np.sin(alpha), r * np.cos(alpha), q * np.sin(beta), q * np.cos(beta)], axis=1)
    return np.array([rigid.rotation_from_quaternion(x) for x in quaternions])


def around(T_bone_points: Array) -> Poses:
    """Return a pose, and the same turned about the points' centre by up to some 30 degrees."""
    axes = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)],
                    dtype=np.float64)
    axes = axes[np.abs(axes).sum(axis=1) > 0]
    turns = [np.zeros(3)] + [
        math.radians(angle) * a / np.linalg.norm(a) for angle in (10.0, 20.0, 30.0) for a in axes
    ]
    R = np.array([rigid.rotation_exp(turn) @ T_bone_points[:3, :3] for turn in turns])
    return Poses(R, np.tile(T_bone_points[:3, 3], (len(R), 1)))


def distinct(R: Array, t: Array, points: Array, separation: float, count: int) -> NDArray[np.int64]:
    """
    Return the first ``count`` poses that move the points ``separation`` (RMS) or more apart.

    Parameters
    ----------
    R, t : (m, 3, 3) and (m, 3) float64, m, as of `Poses`
    points : (n, 3) float64, m, about their centroid, which comes to t
    separation : float, m

    """
    # the RMS distance of two poses over the points is a norm of [R, t]: embed them, then compare
    _, spread, axes = np.linalg.svd(points, full_matrices=False)
    turned = R @ (axes.T * spread / math.sqrt(len(points)))
    return _distinct(np.concatenate([turned.reshape(len(turned), -1), t], axis=1), separation**2,
                     count)


@compiled
def _distinct(x: Array, separation2: float, count: int) -> NDArray[np.int64]:
    """Return the first ``count`` rows of ``x``, no two of them nearer than sqrt(separation2)."""
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
