# SPDX-License-Identifier: Apache-2.0
"""
Select the points that a pose is computed from.

Above some thousands, more points on the same surface hardly improve the pose, but each takes time
and memory. At most a fixed number is used then, spread evenly over all points in the order they
were collected, so that every stroke and every kind of outlier keeps its share. Only places where
the tip rested, which collect thousands of points, are limited to a small share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.point_filters import RADIUS, first_duplicate, on_strokes
from gsdf_registration.common.result import INLIER_WEIGHT
from gsdf_registration.common.rigid import Array, rms

Indices = NDArray[np.int64]

# Points that a registration uses. With ten times as many, the error of the pose decreases by some
# hundredths of a millimetre, below the accuracy of model and tracker.
MAX_POINTS = 10_000
# The filter of isolated points checks at most this many times the maximum number of points
CHECKED = 4
# A cube with edges of `RADIUS` contains at most one in this many of the points used. A stroke
# crosses hundreds of them.
CUBE_SHARE = 40
OUTLYING = 5.0      # times the RMS residual of the points on the bone
CUBES = 2**16       # along each axis, to either side of the median; others join the last ones


@dataclass(frozen=True)
class PointSelection:
    """
    Which of n points are used, and why the others are not.

    total : int, n
    rows : (u,) int, of the points used, ascending
    isolated : int, scattered outliers among the points checked
    repeated : int, repeated readings among the points checked
    on_strokes : int, estimated number of points on strokes among all points
    """

    total: int
    rows: Indices
    isolated: int
    repeated: int
    on_strokes: int

    @property
    def used(self) -> NDArray[np.bool_]:
        """Whether each point is used, (n,)."""
        mask = np.zeros(self.total, dtype=bool)
        mask[self.rows] = True
        return mask

    @property
    def left_out(self) -> dict[str, int]:
        """Number of points that are not used, by cause; with `rows` they add up to n."""
        downsampled = self.total - len(self.rows) - self.isolated - self.repeated
        return {'isolated': self.isolated, 'repeated': self.repeated, 'downsampled': downsampled}


def select_points(points: Array, limit: int = MAX_POINTS) -> PointSelection:
    """
    Select at most ``limit`` points on strokes.

    The result depends only on the points and their order.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    limit : int

    """
    checked = evenly_thinned(points, limit, CHECKED * limit)
    seen = points[checked]
    dense = on_strokes(seen)
    first = first_duplicate(seen) == np.arange(len(seen))
    rows = checked[dense & first]
    return PointSelection(
        len(points), rows[evenly_thinned(points[rows], limit, limit)], int((~dense).sum()),
        int((dense & ~first).sum()), len(rows) * len(points) // max(len(checked), 1))


def evenly_thinned(points: Array, limit: int, count: int) -> Indices:
    """
    Return the rows of ``points`` (n, 3), or of ``count`` of them, evenly spread.

    No cube then contains more than its share of ``limit`` points. With at most ``limit`` points,
    all are returned.
    """
    if len(points) <= limit:
        return np.arange(len(points))
    return evenly_spread(_without_clumps(points, max(limit // CUBE_SHARE, 1), count), count)


def evenly_spread(rows: Indices, limit: int) -> Indices:
    """Return ``rows`` (n,), or ``limit`` of them, evenly spread from the first to the last."""
    if len(rows) <= limit:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, limit).astype(np.int64)])


def _without_clumps(points: Array, share: int, count: int) -> Indices:
    """
    Return the rows of ``points`` (n, 3) without most of those of a stationary tip.

    When they are thinned to ``count`` points, no cube contains more than ``share`` of them.
    """
    cell = np.floor((points - np.median(points, axis=0)) / RADIUS)
    cell = np.clip(cell, -CUBES, CUBES - 1.0).astype(np.int64) + CUBES
    key = (cell[:, 0] * 2 * CUBES + cell[:, 1]) * 2 * CUBES + cell[:, 2]
    _, cube, counts = np.unique(key, return_inverse=True, return_counts=True)
    most = _points_per_cube(counts, share, count)
    if most >= counts.max():
        return np.arange(len(points))
    order = np.argsort(cube, kind='stable')
    size = counts[cube[order]]
    rank = np.arange(len(points)) - (np.cumsum(counts) - counts)[cube[order]]
    # of a cube with more, every point at which the number to keep so far increases
    kept = (size <= most) | (rank * most // size != (rank - 1) * most // size)
    return np.sort(order[kept])


def _points_per_cube(counts: NDArray[np.int64], share: int, count: int) -> int:
    """Return how many points a cube may contain, of which contain ``counts`` (m,) now."""
    most = int(counts.max())
    while True:
        # of so many, `share` are left when all that remain are thinned to `count`
        remaining = int(np.minimum(counts, most).sum())
        fewer = max(share, share * remaining // count)
        if fewer >= most:
            return most
        most = fewer


def weights_of_all(points: Array, rows: Indices, weights: Array, residuals: Array) -> Array:
    """
    Return weights (n,) for all points from those of the points used.

    A point has the weight of the nearest point used, or 0 if it is much farther from the surface
    than the points that lie on the bone.

    Parameters
    ----------
    points : (n, 3) float, metres, tracker frame
    rows : (u,) int
        Of the points used.
    weights : (u,) float
        Of the points used.
    residuals : (n,) float, metres
        Of all points, at the pose.

    """
    found = np.zeros(len(points))
    found[rows] = weights
    rest = np.ones(len(points), dtype=bool)
    rest[rows] = False
    inliers = weights > INLIER_WEIGHT
    if not rest.any() or not inliers.any():
        return found
    nearest = cKDTree(points[rows]).query(points[rest])[1]
    limit = OUTLYING * rms(residuals[rows][inliers])
    found[rest] = np.where(np.abs(residuals[rest]) <= limit, weights[nearest], 0.0)
    return found
