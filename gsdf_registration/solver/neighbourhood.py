# SPDX-License-Identifier: Apache-2.0
"""The points nearest to each along the bone, at once or kept up while points come in."""

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
FLATTENED = 0.75    # share of its distance to the bone that a point is moved to find neighbours


def nearest_neighbours(points: Array, field: Field, T_bone_tracker: Array,
                       count: int = NEIGHBOURS) -> NDArray[np.int64]:
    """
    Return indices (n, count) of the points nearest to each of ``points`` (n, 3), itself first.

    Nearest along the bone: most of a point's distance to it is taken away first, or points would
    be neighbours for having the same noise, and its mean over them no longer small.
    """
    return _nearest(_flattened(points, field, T_bone_tracker), count)


def _flattened(points: Array, field: Field, T_bone_tracker: Array) -> Array:
    """Return where points (n, 3), tracker frame, lie along the bone, bone frame."""
    placed = rigid.transform(T_bone_tracker, points)
    distance, gradient = field.sample(placed)
    return np.asarray(placed - FLATTENED * distance[:, None] * gradient)


def _nearest(places: Array, count: int) -> NDArray[np.int64]:
    """Return indices (n, count) of the places nearest to each of ``places`` (n, 3)."""
    nearest = cKDTree(places).query(places, k=min(count, len(places)))[1]
    return np.ascontiguousarray(nearest.reshape(len(places), -1), dtype=np.int64)


class Neighbourhood:
    """
    The `nearest_neighbours` of points that grow in number.

    A point added is compared with all others, some 3 us for each thousand of them: far less than
    to find all neighbours anew. The pose is that of the beginning; as it settles, by less than
    strokes are apart, where points lie along the bone hardly changes.

    Parameters
    ----------
    points : (n, 3) float, metres, tracker frame
    field : of the bone
    T_bone_tracker : (4, 4) float, metres
    count : int
        Neighbours of each, itself included.

    """

    def __init__(self, points: Array, field: Field, T_bone_tracker: Array,
                 count: int = NEIGHBOURS) -> None:
        self._field, self._T_bone_tracker, self._count = field, T_bone_tracker, count
        self._begin(_flattened(points, field, T_bone_tracker))

    def _begin(self, places: Array) -> None:
        """Take these places and no others."""
        self._size, self._places = len(places), places
        self._nearest = _nearest(places, self._count)
        self._squared = ((places[self._nearest] - places[:, None])**2).sum(axis=2)

    def __len__(self) -> int:
        """Return the number of points."""
        return self._size

    @property
    def indices(self) -> NDArray[np.int64]:
        """The points nearest to each, itself first: (n, count), valid until more are added."""
        return self._nearest[:self._size]

    def add(self, points: Array) -> None:
        """Add ``points`` (m, 3), metres, tracker frame."""
        places = _flattened(points, self._field, self._T_bone_tracker)
        if self._size < self._count:    # so few that not even the shape of the table is final
            self._begin(np.concatenate([self._places[:self._size], places]))
            return
        wanted = self._size + len(places)
        if wanted > len(self._places):
            # room for as many again, so that growing takes next to no time on average
            self._places, self._nearest, self._squared = (
                np.concatenate([held, np.empty((2 * wanted - len(held), *held.shape[1:]),
                                               held.dtype)])
                for held in (self._places, self._nearest, self._squared))
        self._places[self._size:wanted] = places
        _introduce(self._places, self._size, wanted, self._nearest, self._squared)
        self._size = wanted


@kernel
def _introduce(places, first, end, nearest, squared):
    """Enter the points ``first`` .. ``end`` - 1 among the nearest of those before them."""
    last = nearest.shape[1] - 1
    for new in range(first, end):
        x, y, z = places[new, 0], places[new, 1], places[new, 2]
        nearest[new, 0], squared[new, 0] = new, 0.0
        squared[new, 1:] = np.inf
        for old in range(new):
            dx, dy, dz = places[old, 0] - x, places[old, 1] - y, places[old, 2] - z
            d = dx * dx + dy * dy + dz * dz
            if d < squared[old, last]:
                _enter(nearest[old], squared[old], new, d)
            if d < squared[new, last]:
                _enter(nearest[new], squared[new], old, d)


@kernel
def _enter(nearest, squared, point, d):
    """Put ``point`` at squared distance ``d`` in its place; the farthest is left out."""
    i = len(squared) - 1
    while i > 1 and squared[i - 1] > d:     # a point itself stays first
        nearest[i], squared[i] = nearest[i - 1], squared[i - 1]
        i -= 1
    nearest[i], squared[i] = point, d
