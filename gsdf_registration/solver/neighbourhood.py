# SPDX-License-Identifier: Apache-2.0
"""Nearest neighbours of points along the bone surface, also for a growing set of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common import rigid
from gsdf_registration.common.numba_options import kernel
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field

# points whose mean residual tells bone from interference: more of them average out more noise,
# fewer resolve smaller patches of interference
NEIGHBOURS = 16
PROJECTED = 0.75    # share of its distance to the bone by which a point is moved for the search


def nearest_neighbours(points: Array, field: Field, T_bone_tracker: Array,
                       count: int = NEIGHBOURS) -> NDArray[np.int64]:
    """
    Return indices (n, count) of the points nearest to each of ``points`` (n, 3), itself first.

    Points are first moved most of the way onto the bone. Otherwise points with similar noise would
    be neighbours, and the mean of their noise would not be small.
    """
    return _nearest(_projected(points, field, T_bone_tracker), count)


def _projected(points: Array, field: Field, T_bone_tracker: Array) -> Array:
    """Return points (n, 3), tracker frame, moved towards the bone surface, bone frame."""
    placed = rigid.transform(T_bone_tracker, points)
    distance, gradient = field.sample(placed)
    return np.asarray(placed - PROJECTED * distance[:, None] * gradient)


def _nearest(places: Array, count: int) -> NDArray[np.int64]:
    """Return indices (n, count) of the positions nearest to each of ``places`` (n, 3)."""
    if not len(places):
        return np.empty((0, 1), dtype=np.int64)
    nearest = cKDTree(places).query(places, k=min(count, len(places)))[1]
    return np.ascontiguousarray(nearest.reshape(len(places), -1), dtype=np.int64)


class Neighbourhood:
    """
    The `nearest_neighbours` of a growing set of points.

    A new point is compared with all others, about 3 us per thousand: much faster than a search for
    all neighbours again. The pose stays the initial one: while it converges, it moves by less than
    the distance between strokes, and the positions along the bone hardly change.

    Parameters
    ----------
    points : (n, 3) float, metres, tracker frame
    field : of the bone
    T_bone_tracker : (4, 4) float, metres
    count : int
        Neighbours of each point, including itself.

    """

    def __init__(self, points: Array, field: Field, T_bone_tracker: Array,
                 count: int = NEIGHBOURS) -> None:
        self._field, self._T_bone_tracker, self._count = field, T_bone_tracker, count
        self._reset(_projected(points, field, T_bone_tracker))

    def _reset(self, places: Array) -> None:
        """Start again with these positions."""
        self._size, self._places = len(places), places
        self._nearest = _nearest(places, self._count)
        self._squared = ((places[self._nearest] - places[:, None])**2).sum(axis=2)

    def __len__(self) -> int:
        """Return the number of points."""
        return self._size

    @property
    def indices(self) -> NDArray[np.int64]:
        """Points nearest to each, itself first: (n, count), valid until points are added."""
        return self._nearest[:self._size]

    def add(self, points: Array) -> None:
        """Add ``points`` (m, 3), metres, tracker frame."""
        places = _projected(points, self._field, self._T_bone_tracker)
        if self._size < self._count:    # the table still has fewer than `count` columns
            self._reset(np.concatenate([self._places[:self._size], places]))
            return
        size = self._size + len(places)
        if size > len(self._places):
            # double the capacity, so that growing takes constant time per point on average
            self._places, self._nearest, self._squared = (
                np.concatenate([rows, np.empty((2 * size - len(rows), *rows.shape[1:]),
                                               rows.dtype)])
                for rows in (self._places, self._nearest, self._squared))
        self._places[self._size:size] = places
        _add_points(self._places, self._size, size, self._nearest, self._squared)
        self._size = size


@kernel
def _add_points(places, first, end, nearest, squared):
    """Fill the rows of points ``first`` to ``end`` - 1, and insert them into the rows before."""
    last = nearest.shape[1] - 1
    for new in range(first, end):
        x, y, z = places[new, 0], places[new, 1], places[new, 2]
        nearest[new, 0], squared[new, 0] = new, 0.0
        squared[new, 1:] = np.inf
        for old in range(new):
            dx, dy, dz = places[old, 0] - x, places[old, 1] - y, places[old, 2] - z
            d = dx * dx + dy * dy + dz * dz
            if d < squared[old, last]:
                _insert(nearest[old], squared[old], new, d)
            if d < squared[new, last]:
                _insert(nearest[new], squared[new], old, d)


@kernel
def _insert(nearest, squared, point, d):
    """Insert ``point`` at squared distance ``d`` into a sorted row; the farthest is dropped."""
    i = len(squared) - 1
    while i > 1 and squared[i - 1] > d:     # the point itself stays first
        nearest[i], squared[i] = nearest[i - 1], squared[i - 1]
        i -= 1
    nearest[i], squared[i] = point, d
