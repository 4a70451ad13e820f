# SPDX-License-Identifier: Apache-2.0
"""The generalized winding number of a mesh, with or without holes (Jacobson et al. 2013)."""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.rigid import Array


def winding_numbers(vertices: Array, faces: np.ndarray, points: Array) -> Array:
    """
    Return the winding number of the mesh at each point.

    It is 1 inside and 0 outside a closed, outward-oriented mesh, in between near holes, and on a
    face the mean of both sides.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int64
    points : (k, 3) float64

    Returns
    -------
    (k,) float64

    """
    total = np.zeros(len(points))
    _add_angles(vertices, faces, points, total)
    return total / (2.0 * math.pi)


@compiled
def _add_angles(vertices: Array, faces: np.ndarray, points: Array, total: Array) -> None:
    """Add half the solid angle of every face to ``total`` (k,) (van Oosterom & Strackee 1983)."""
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        for f in range(len(faces)):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay, az = vertices[i, 0] - x, vertices[i, 1] - y, vertices[i, 2] - z
            bx, by, bz = vertices[j, 0] - x, vertices[j, 1] - y, vertices[j, 2] - z
            cx, cy, cz = vertices[k, 0] - x, vertices[k, 1] - y, vertices[k, 2] - z
            a = math.sqrt(ax * ax + ay * ay + az * az)
            b = math.sqrt(bx * bx + by * by + bz * bz)
            c = math.sqrt(cx * cx + cy * cy + cz * cz)
            volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            if abs(volume) > 1e-9 * a * b * c:      # in the plane of the face it is 0
                ab = ax * bx + ay * by + az * bz
                bc = bx * cx + by * cy + bz * cz
                ca = cx * ax + cy * ay + cz * az
                total[p] += math.atan2(volume, a * b * c + ab * c + bc * a + ca * b)
