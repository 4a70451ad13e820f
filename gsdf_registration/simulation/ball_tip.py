# SPDX-License-Identifier: Apache-2.0
"""
Replace the sharp tip of a simulated probe by a ball that rolls on the bone.

The centre of a ball of radius r in contact is exactly r away from the nearest point of the mesh.
Above a smooth place this is the touched point moved by r along the normal. In a groove narrower
than the ball, this position would penetrate the other wall: the ball rests on both walls instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.probe import SimulatedRecording
from gsdf_registration.simulation.surface_errors import displaced

TOLERANCE = 1e-7    # m, of the distance of a centre in contact
PROJECTIONS = 400   # onto one wall after the other; in a groove of 60 degrees about 20 are needed
LIFTS = 12          # radii by which a ball that does not fit is lifted before it is lowered again


class BallContact:
    """
    Where a ball touches a closed mesh.

    Parameters
    ----------
    vertices : (n, 3) float, m
    faces : (m, 3) int, counter-clockwise seen from outside

    """

    def __init__(self, vertices: Array, faces: NDArray[np.int64]) -> None:
        self._corners = np.asarray(vertices, dtype=np.float64)[faces]
        a, b, c = np.moveaxis(self._corners, 1, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.where(length > 0.0, length, 1.0)
        middles = self._corners.mean(axis=1)
        self._middles = cKDTree(middles)
        self._widest = np.linalg.norm(self._corners - middles[:, None], axis=2).max()

    def nearest(self, points: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        """Return signed distances (n,), nearest surface points (n, 3) and their triangles (n,)."""
        # no triangle is nearer than its middle less its own size
        reach = self._middles.query(points)[0] + self._widest + TOLERANCE
        lists = self._middles.query_ball_point(points, reach)
        row = np.repeat(np.arange(len(points)), [len(each) for each in lists])
        triangle = np.concatenate([np.asarray(each, dtype=np.int64) for each in lists])
        closest = _closest_points(points[row], self._corners[triangle])
        arm = points[row] - closest
        squared = (arm**2).sum(axis=1)
        height = (arm * self._normals[triangle]).sum(axis=1)
        least = np.full(len(points), np.inf)
        np.minimum.at(least, row, squared)
        # at an edge several triangles are equally near: that which faces the point most decides
        # the side
        equal = np.where(squared <= least[row] * (1.0 + 1e-9) + 1e-24, np.abs(height), -1.0)
        order = np.lexsort((equal, row))
        best = order[np.append(np.flatnonzero(np.diff(row[order])), len(order) - 1)]
        return (np.copysign(np.sqrt(squared[best]), height[best]), closest[best], triangle[best])

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Return signed distances (n,), m, and outward normals (n, 3) of the nearest triangles."""
        distances, _, triangles = self.nearest(points)
        return distances, self._normals[triangles]

    def centres(self, touched: Array, radius: float, approach: Array) -> Array:
        """
        Return the centres of a ball that is pressed towards points of the surface.

        Parameters
        ----------
        touched : (n, 3) float, m, on the surface
        radius : float, m
        approach : (3,) float, unit, from the bone toward the hand

        Returns
        -------
        (n, 3) float, m, at a distance of ``radius`` from the mesh; NaN where the ball cannot get

        """
        normals = self._normals[self.nearest(touched)[2]]
        centres = np.full(touched.shape, np.nan)
        pending = np.arange(len(touched))
        for lift in range(LIFTS + 1):
            if not len(pending):
                break
            start = touched[pending] + radius * (normals[pending] + lift * approach)
            found = self._in_contact(start, radius)
            centres[pending] = found
            pending = pending[np.isnan(found[:, 0])]
        return centres

    def _in_contact(self, centres: Array, radius: float) -> Array:
        """Project centres onto the offset surface; NaN for those that start inside the mesh."""
        centres = centres.copy()
        distance, closest, _ = self.nearest(centres)
        centres[distance < 0.0] = np.nan
        active = np.flatnonzero((distance >= 0.0) & (np.abs(distance - radius) > TOLERANCE))
        for _ in range(PROJECTIONS):
            if not len(active):
                return centres
            arm = centres[active] - closest[active]
            arm *= radius / np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), 1e-12)
            centres[active] = closest[active] + arm
            distance[active], closest[active], _ = self.nearest(centres[active])
            active = active[np.abs(distance[active] - radius) > TOLERANCE]
        centres[active] = np.nan
        return centres


def with_ball_tip(recording: SimulatedRecording, vertices: Array, faces: NDArray[np.int64],
                  approach: Array, radius: float) -> SimulatedRecording:
    """
    Return a recording of the centre of a ball tip, from that of a sharp tip.

    Noise, stamps and interference are the same. Samples on the bone and on soft tissue move by the
    radius; others, which lie in the air or on another object, stay. Samples on places that the ball
    cannot touch are dropped.

    Parameters
    ----------
    recording : of a sharp tip
    vertices, faces : of the bone that was touched, (n, 3) float, m, and (m, 3) int
    approach : (3,) float, unit, from the bone toward the hand
    radius : float, m

    Raises
    ------
    InputError
        If the radius is not a positive number.

    """
    if not 0.0 < radius < np.inf:
        raise InputError(f'the radius of a ball tip must be positive, not {radius:g}')
    contact, tips = BallContact(vertices, faces), recording.tips.copy()
    on_bone, soft = recording.on_bone, recording.kinds == Kind.SOFT_TISSUE
    if on_bone.any():
        tips[on_bone] = contact.centres(tips[on_bone], radius, approach)
    if soft.any():
        arm = tips[soft] - contact.nearest(tips[soft])[1]
        tips[soft] += radius * arm / np.linalg.norm(arm, axis=1, keepdims=True)
    kept = np.asarray(np.isfinite(tips).all(axis=1))
    return displaced(recording.part(kept), (tips - recording.tips)[kept])


def _closest_points(points: Array, corners: Array) -> Array:
    """Return the point (n, 3) of each triangle (n, 3, 3) that is nearest to each of ``points``."""
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, ac, p = b - a, c - a, points - a
    abab, abac, acac = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    d1, d2 = _dot(ab, p), _dot(ac, p)
    det = np.maximum(abab * acac - abac**2, 1e-300)
    v, w = (acac * d1 - abac * d2) / det, (abab * d2 - abac * d1) / det
    nearest = a + v[:, None] * ab + w[:, None] * ac     # in the plane
    outside = (v < 0.0) | (w < 0.0) | (v + w > 1.0)
    squared = np.where(outside, np.inf, 0.0)
    for first, edge in ((a, ab), (a, ac), (b, c - b)):
        share = np.clip(_dot(points - first, edge) / np.maximum(_dot(edge, edge), 1e-300), 0.0, 1.0)
        on_edge = first + share[:, None] * edge
        away = _dot(points - on_edge, points - on_edge)
        nearer = away < squared
        nearest[nearer], squared[nearer] = on_edge[nearer], away[nearer]
    return nearest


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=1))
