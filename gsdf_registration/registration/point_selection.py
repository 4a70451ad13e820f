# SPDX-License-Identifier: Apache-2.0
"""
Select the points that a pose is computed from.

The points of a stationary tip are one piece of evidence, however many they are. So the number of
points in a small ball is limited.

Above some thousands, more points on the same surface hardly improve the pose, but each takes time
and memory. At most a fixed number is used then, spread evenly over all points in the order they
were collected, so that every stroke and every kind of outlier keeps its share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.downsampling import limit_density, voxel_downsample
from gsdf_registration.common.point_filters import first_duplicate, on_strokes
from gsdf_registration.common.result import INLIER_WEIGHT
from gsdf_registration.common.rigid import Array, rms

Indices = NDArray[np.int64]

# Points that a registration uses. With ten times as many, the error of the pose decreases by some
# hundredths of a millimetre, below the accuracy of model and tracker.
MAX_POINTS = 10_000
# The filter of isolated points checks at most this many times the maximum number of points
CHECKED = 4
# At most this many points are used within this radius, m. A stroke has some three there, a tip at
# rest hundreds, which share one error: of the tissue under the tip, or of the model.
CLUMP_RADIUS, CLUMP_POINTS = 5e-4, 8
PLACES = 1000       # at which the usual number is counted
OUTLYING = 5.0      # times the RMS residual of the points on the bone


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
    spaced = without_clumps(points)
    checked = evenly_spread(spaced, CHECKED * limit)
    seen = points[checked]
    dense = on_strokes(seen)
    first = first_duplicate(seen) == np.arange(len(seen))
    rows = checked[dense & first]
    return PointSelection(
        len(points), evenly_spread(rows, limit), int((~dense).sum()), int((dense & ~first).sum()),
        len(rows) * len(spaced) // max(len(checked), 1))


def without_clumps(points: Array) -> Indices:
    """
    Return the rows of ``points`` (n, 3) without most of those of a stationary tip.

    The faster the tracker, the more points are in a ball of `CLUMP_RADIUS` on a stroke. As many as
    in the densest tenth of all places may stay: a fixed number would favour the points of fast
    motion, through the air, over those of strokes.
    """
    places = evenly_spread(voxel_downsample(points, 2.0 * CLUMP_RADIUS), PLACES)
    count = cKDTree(points).query_ball_point(points[places], CLUMP_RADIUS, return_length=True)
    return limit_density(points, CLUMP_RADIUS, max(CLUMP_POINTS, int(np.quantile(count, 0.9))))


def evenly_spread(rows: Indices, limit: int) -> Indices:
    """Return ``rows`` (n,), or ``limit`` of them, evenly spread from the first to the last."""
    if len(rows) <= limit:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, limit).astype(np.int64)])


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
