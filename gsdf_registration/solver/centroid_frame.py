# SPDX-License-Identifier: Apache-2.0
"""From a pose to that of the points about their centroid, and back."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.numba_options import kernel


@kernel
def about_centroid(points, T, centred, centre, R, t):
    """Fill points (n, 3) less their ``centre`` (3,), and the pose ``T`` (4, 4) of these: R, t."""
    centre[:] = 0.0
    for k in range(len(points)):
        for i in range(3):
            centre[i] += points[k, i]
    centre /= len(points)
    for k in range(len(points)):
        for i in range(3):
            centred[k, i] = points[k, i] - centre[i]
    R[:] = T[:3, :3]
    _orthonormalize(R)
    for i in range(3):
        t[i] = T[i, 0] * centre[0] + T[i, 1] * centre[1] + T[i, 2] * centre[2] + T[i, 3]


@kernel
def pose_about(centre, R, t, T):
    """Fill ``T`` (4, 4), the pose of the points themselves, with its rotation made exact."""
    _orthonormalize(R)
    T[:] = 0.0
    T[:3, :3] = R
    for i in range(3):
        T[i, 3] = t[i] - R[i, 0] * centre[0] - R[i, 1] * centre[1] - R[i, 2] * centre[2]
    T[3, 3] = 1.0


@kernel
def _orthonormalize(R):
    """Take ``R``, nearly a rotation, to the nearest: a Newton step of its polar decomposition."""
    S = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            S[i, j] = -0.5 * (R[0, i] * R[0, j] + R[1, i] * R[1, j] + R[2, i] * R[2, j])
        S[i, i] += 1.5
    for i in range(3):
        x, y, z = R[i, 0], R[i, 1], R[i, 2]
        for j in range(3):
            R[i, j] = x * S[0, j] + y * S[1, j] + z * S[2, j]
