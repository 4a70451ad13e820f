# SPDX-License-Identifier: Apache-2.0
"""Convert a pose of points to the pose of the same points about their centroid, and back."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.numba_options import kernel


@kernel
def to_centroid_frame(points, T, centred, centroid, R, t):
    """
    Centre the points and convert their pose.

    points, T : (n, 3) and (4, 4), m, the points and their pose
    centred, centroid : (n, 3) and (3,), m, filled
    R, t : (3, 3) and (3,), filled with the pose of the centred points
    """
    centroid[:] = 0.0
    for k in range(len(points)):
        for i in range(3):
            centroid[i] += points[k, i]
    centroid /= len(points)
    for k in range(len(points)):
        for i in range(3):
            centred[k, i] = points[k, i] - centroid[i]
    for i in range(3):
        for j in range(3):      # assigning a slice would take four seconds to compile
            R[i, j] = T[i, j]
    _orthonormalize(R)
    for i in range(3):
        t[i] = T[i, 0] * centroid[0] + T[i, 1] * centroid[1] + T[i, 2] * centroid[2] + T[i, 3]


@kernel
def from_centroid_frame(centroid, R, t, T):
    """Fill ``T`` (4, 4), the pose of the original points; ``R`` is orthonormalized first."""
    _orthonormalize(R)
    for i in range(3):
        for j in range(3):
            T[i, j] = R[i, j]
        T[3, i] = 0.0
        T[i, 3] = t[i] - R[i, 0] * centroid[0] - R[i, 1] * centroid[1] - R[i, 2] * centroid[2]
    T[3, 3] = 1.0


@kernel
def _orthonormalize(R):
    """Replace ``R``, nearly a rotation, by the nearest: a Newton step of polar decomposition."""
    S = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            S[i, j] = -0.5 * (R[0, i] * R[0, j] + R[1, i] * R[1, j] + R[2, i] * R[2, j])
        S[i, i] += 1.5
    for i in range(3):
        x, y, z = R[i, 0], R[i, 1], R[i, 2]
        for j in range(3):
            R[i, j] = x * S[0, j] + y * S[1, j] + z * S[2, j]
