# SPDX-License-Identifier: Apache-2.0
"""
Select the points that a pose is computed from: points on strokes, and touches.

The positions of a tip at rest are one piece of evidence, however many they are: they share the
error of the tissue under the tip, and of the model. So a rest becomes one point, a touch. Points
that were captured one by one are touches as well.

Above some thousands, more points on the same surface hardly improve the pose, but each takes time
and memory. At most a fixed number is used then, spread evenly over all points in the order they
were collected, so that every stroke and every kind of outlier keeps its share.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.point_filters import first_duplicate, in_clusters
from gsdf_registration.common.rests import Rests, find_rests
from gsdf_registration.common.result import INLIER_WEIGHT
from gsdf_registration.common.rigid import Array, rms
from gsdf_registration.solver import NO_TOUCHES

Indices = NDArray[np.int64]

# Points that a registration uses. With ten times as many, the error of the pose decreases by some
# hundredths of a millimetre, below the accuracy of model and tracker.
MAX_POINTS = 10_000
# The filter of isolated points checks at most this many times the maximum number of points
CHECKED = 4
CAUSES = ('isolated', 'repeated', 'resting', 'moving', 'downsampled')
OUTLYING = 5.0      # times the RMS residual of the points on the bone
# Noise of a rest over that of a point on a stroke, at least: the error of the model is the same
MIN_NOISE = 0.5


@dataclass(frozen=True, eq=False)
class PointSelection:
    """
    Which of n points are used, and why the others are not.

    total : int, n
    positions : (u, 3) float, m, of the points used: on strokes first, then touches
    rows : (u,) int, which of the points each is; of a rest the nearest one
    touches : (t,) float, relative noise of the touches, see `gsdf_registration.solver.touches`
    left_out : number of points that are not used, by cause; with ``rows`` they add up to n:
        isolated (scattered outliers among the points checked), repeated (readings), resting (at a
        rest, of which one counts), moving (between touches), downsampled
    on_strokes : int, estimated number of points on strokes among all points, and of touches
    rests : int, how many of the touches, the last ones, are rests of the tip
    """

    total: int
    positions: Array
    rows: Indices
    touches: Array
    left_out: dict[str, int]
    on_strokes: int
    rests: int = 0

    @property
    def strokes(self) -> int:
        """Number of points used that are on strokes."""
        return len(self.rows) - len(self.touches)

    def thinned(self, limit: int) -> PointSelection:
        """Return the selection with at most ``limit`` points on strokes, evenly spread."""
        kept = np.concatenate([evenly_spread(np.arange(self.strokes), limit),
                               np.arange(self.strokes, len(self.rows))])
        return self._only(kept, 'downsampled')

    def rests_alone(self) -> PointSelection:
        """Return the selection with the rests of the tip only."""
        used = len(self.rows)
        alone = self._only(np.arange(used - self.rests, used), 'moving')
        touches = self.touches[len(self.touches) - self.rests:]
        typical = float(np.median(touches)) if self.rests else 1.0
        return replace(alone, touches=touches / typical, on_strokes=self.rests)

    def _only(self, kept: Indices, cause: str) -> PointSelection:
        """Return the selection with the ``kept`` points; the others are left out by ``cause``."""
        fewer = len(self.rows) - len(kept)
        return replace(self, positions=self.positions[kept], rows=self.rows[kept],
                       left_out=self.left_out | {cause: self.left_out[cause] + fewer})

    def attempts(self, min_points: int) -> Iterator[PointSelection]:
        """
        Yield the rests alone, if there are ``min_points``, and this selection.

        A probe that touches a bone here and there moves through the air between, so the other
        points may be no strokes.
        """
        if min_points <= self.rests < len(self.rows):
            yield self.rests_alone()
        yield self


def select_points(points: Array, mode: str = 'both', limit: int = MAX_POINTS) -> PointSelection:
    """
    Select touches and at most ``limit`` points on strokes.

    The result depends only on the points and their order.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
        Finite, in the order they were measured. Of points in another order, rests are not found.
    mode : 'strokes', 'touches' or 'both'
        What counts. Points that were captured one by one are touches.
    limit : int

    """
    rests = find_rests(points)
    moving = np.flatnonzero(rests.which < 0)
    resting = len(points) - len(moving)
    left_out = dict.fromkeys(CAUSES, 0)
    if mode == 'touches' and resting:
        return _with_rests(points, rests, moving[:0], NO_TOUCHES,
                           left_out | {'moving': len(moving)}, 0)
    checked = evenly_spread(moving, CHECKED * limit)
    seen = points[checked]
    used = in_clusters(seen)
    # without clusters the points were captured one by one, unless most are at rest
    singly = (mode == 'touches' or not used.any()) and 2 * resting <= len(points)
    used = used | singly
    first = first_duplicate(seen) == np.arange(len(seen))
    rows = checked[used & first]
    left_out['isolated'], left_out['repeated'] = int((~used).sum()), int((used & ~first).sum())
    total = len(rows) * len(moving) // max(len(checked), 1)
    rows = evenly_spread(rows, limit)
    left_out['downsampled'] = len(moving) - len(rows) - sum(left_out.values())
    touches = np.ones(len(rows)) if singly and mode != 'strokes' else NO_TOUCHES
    if mode == 'strokes':
        return PointSelection(len(points), points[rows], rows, NO_TOUCHES,
                              left_out | {'resting': resting}, total)
    return _with_rests(points, rests, rows, touches, left_out, total)


def _with_rests(points: Array, rests: Rests, rows: Indices, touches: Array,
                left_out: dict[str, int], total: int) -> PointSelection:
    """Return the selection of ``rows``, of which the last are ``touches``, and of the rests."""
    places, resting = len(rests.positions), np.flatnonzero(rests.which >= 0)
    selection = PointSelection(
        len(points), np.concatenate([points[rows], rests.positions]),
        np.concatenate([rows, _nearest_samples(points, rests, resting)]),
        np.concatenate([touches, _relative_noise(rests)]),
        left_out | {'resting': len(resting) - places}, total + places, places)
    return selection if len(rows) else selection.rests_alone()


def _nearest_samples(points: Array, rests: Rests, resting: Indices) -> Indices:
    """Return which of the ``resting`` points is nearest to the position of each rest (r,)."""
    rest = rests.which[resting]
    off = ((points[resting] - rests.positions[rest])**2).sum(axis=1)
    order = np.lexsort((off, rest))
    first = np.r_[True, np.diff(rest[order]) > 0] if len(order) else np.zeros(0, dtype=bool)
    return np.asarray(resting[order[first]])


def _relative_noise(rests: Rests) -> Array:
    """Return the noise of each rest (r,) over that of a point on a stroke."""
    if not len(rests.noise):
        return NO_TOUCHES
    noise = float(np.median(rests.noise))
    typical = np.clip(noise / max(float(np.median(rests.spread)), 1e-12), MIN_NOISE, 1.0)
    return np.asarray(typical * rests.noise / noise)


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
