# SPDX-License-Identifier: Apache-2.0
"""
Implicit solids: functions that approximate the signed distance in millimetres, negative inside.

Every function accepts points as three arrays ``p = (x, y, z)`` of equal shape and returns one array
of that shape.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from gsdf_registration.common.rigid import Array, rotation_exp

Points = tuple[Array, Array, Array]


def join(a: Array, b: Array, blend: float) -> Array:
    """Return the smooth union of two solids, blended over ``blend`` mm (polynomial smooth min)."""
    h = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.minimum(a, b) - h * h * blend / 4.0


def carve(a: Array, b: Array, blend: float) -> Array:
    """Return solid ``a`` without ``b``, a smooth difference blended over ``blend`` mm."""
    return -join(-a, b, blend)


def moved(p: Points, centre: ArrayLike, turn: ArrayLike = (0.0, 0.0, 0.0)) -> Points:
    """Return the points in a frame at ``centre``, mm, with rotation vector ``turn``, degrees."""
    R = rotation_exp(np.radians(np.asarray(turn, dtype=np.float64)))
    q = [p[i] - float(np.asarray(centre)[i]) for i in range(3)]
    x, y, z = (q[0] * R[0, i] + q[1] * R[1, i] + q[2] * R[2, i] for i in range(3))
    return x, y, z


def ellipsoid(p: Points, centre: ArrayLike, radii: ArrayLike,
              turn: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Return an ellipsoid, whose value is a first-order distance."""
    q = moved(p, centre, turn)
    a, b, c = np.asarray(radii, dtype=np.float64)
    k = np.sqrt((q[0] / a) ** 2 + (q[1] / b) ** 2 + (q[2] / c) ** 2)
    g = np.sqrt((q[0] / a**2) ** 2 + (q[1] / b**2) ** 2 + (q[2] / c**2) ** 2)
    return np.where(k > 0.0, k * (k - 1.0) / np.maximum(g, 1e-9), -min(a, b, c))


def tube(p: Points, path: ArrayLike, radii: Sequence[float], pieces: int = 4) -> Array:
    """Return a curved, tapered tube with ``radii`` at the points of ``path`` (n, 3)."""
    path = np.asarray(path, dtype=np.float64)
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    s = np.unique(np.concatenate([np.linspace(a, b, pieces + 1) for a, b in zip(knots, knots[1:])]))
    centres = CubicSpline(knots, path, bc_type='natural')(s)
    r = np.interp(s, knots, radii)
    out = np.full(p[0].shape, np.inf)
    for a, b, ra, rb in zip(centres, centres[1:], r, r[1:]):
        d = b - a
        q = moved(p, a)
        t = np.clip((q[0] * d[0] + q[1] * d[1] + q[2] * d[2]) / float(d @ d), 0.0, 1.0)
        away = np.sqrt((q[0] - t * d[0]) ** 2 + (q[1] - t * d[1]) ** 2 + (q[2] - t * d[2]) ** 2)
        np.minimum(out, away - (ra + t * (rb - ra)), out=out)
    return out


def polygon(x: Array, y: Array, corners: ArrayLike) -> Array:
    """Return the signed distance to a closed polygon (n, 2) in the plane."""
    corners = np.asarray(corners, dtype=np.float64)
    nearest = np.full(x.shape, np.inf)
    inside = np.zeros(x.shape, dtype=bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0)):
        ex, ey = bx - ax, by - ay
        t = np.clip(((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey), 0.0, 1.0)
        np.minimum(nearest, (x - ax - t * ex) ** 2 + (y - ay - t * ey) ** 2, out=nearest)
        if ey != 0.0:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * ex / ey)
    return np.where(inside, -1.0, 1.0) * np.sqrt(nearest)


def unevenness(p: Points, height: float) -> Array:
    """Return a smooth aperiodic relief of about ``height`` mm, wavelengths 14 to 45 mm."""
    waves = ((0.14, 0.05, -0.09, 0.3), (-0.06, 0.17, 0.08, 1.9), (0.09, -0.12, 0.21, 4.1),
             (0.27, 0.16, 0.04, 2.6), (-0.19, 0.23, -0.14, 5.2), (0.13, 0.29, 0.31, 0.9))
    out = np.zeros(p[0].shape)
    for a, b, c, phase in waves:
        out += np.sin(a * p[0] + b * p[1] + c * p[2] + phase) / len(waves)
    return height * out
