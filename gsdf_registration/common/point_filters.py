# SPDX-License-Identifier: Apache-2.0
"""
Select the points that a registration uses: points on strokes, without duplicates.

A stroke of the probe is dense in space; scattered outliers are isolated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.special import pdtrc

from gsdf_registration.common.components import components
from gsdf_registration.common.downsampling import voxel_grid
from gsdf_registration.common.rigid import Array

# m, within which neighbours are counted: ten times the distance between samples of a slow stroke,
# much less than the distance between outliers that are scattered over a region
RADIUS = 0.004
MIN_NEIGHBOURS = 4      # of a point on a stroke: samples 0.3-0.6 mm apart have a dozen or more
MIN_CLUSTER = 12        # points on a stroke
FEW = 20                # fewer new points are compared with all others, faster than by a tree
VOXELS_PER_RADIUS = 10  # neighbours are counted in a downsampled cloud: one point per voxel


def filter_isolated(points: Array) -> NDArray[np.bool_]:
    """
    Return a mask of the points (n, 3), m, that a registration uses.

    They are on strokes and without duplicates; the others are scattered outliers or repeated
    readings.
    """
    return np.asarray(on_strokes(points) & (first_duplicate(points) == np.arange(len(points))))


def on_strokes(points: Array) -> NDArray[np.bool_]:
    """
    Return a mask of the points that are on strokes and not scattered in space.

    If no point is on a stroke, the points were captured one by one, and all of them are used.

    Parameters
    ----------
    points : (n, 3) float, metres

    """
    found = in_clusters(points)
    return found if found.any() else np.ones(len(points), dtype=bool)


def in_clusters(points: Array) -> NDArray[np.bool_]:
    """
    Return a mask of the points (n, 3), m, that are on strokes.

    A point is on a stroke if it has more neighbours than scattered points have by chance, and if
    it belongs to a cluster of such points.
    """
    if not len(points):
        return np.zeros(0, dtype=bool)
    # one point per voxel: a stationary tip must not slow this down
    chosen, voxel = voxel_grid(points, RADIUS / VOXELS_PER_RADIUS)
    sparse = points[chosen]
    tree = cKDTree(sparse)
    neighbours = tree.query_ball_point(sparse, RADIUS, return_length=True) - 1
    dense = neighbours >= _min_neighbours(neighbours)
    if dense.any():
        pairs = cKDTree(sparse[dense]).query_pairs(RADIUS, output_type='ndarray')
        _, cluster = components(pairs, int(dense.sum()))
        dense[dense] = np.bincount(cluster)[cluster] >= MIN_CLUSTER
    return np.asarray(dense[voxel])


def has_neighbours(points: Array, cloud: Array) -> NDArray[np.bool_]:
    """
    Return a mask of the new points that have enough neighbours to be on a stroke.

    A fast substitute for `on_strokes` while points arrive one by one. Memory is proportional to m
    and n, and the time to (m + n) log n, or to m n if that is less.

    Parameters
    ----------
    points : (m, 3) float, metres
    cloud : (n, 3) float, metres
        All points so far, including ``points``.

    """
    if len(points) < FEW:
        return np.asarray((cdist(points, cloud) <= RADIUS).sum(axis=1) > MIN_NEIGHBOURS)
    # the point itself is the nearest
    distance = cKDTree(cloud).query(points, k=[MIN_NEIGHBOURS + 1],
                                    distance_upper_bound=np.nextafter(RADIUS, 1.0))[0]
    return np.asarray(np.isfinite(distance[:, 0]))


def first_duplicate(points: Array) -> NDArray[np.intp]:
    """Return, for each of the points (n, 3), the index of the first point equal to it."""
    x = np.sort(points[:, 0])
    if not (x[1:] == x[:-1]).any():     # the usual case, and a fast check
        return np.arange(len(points))
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[same.ravel()])


def _min_neighbours(neighbours: NDArray[np.intp]) -> int:
    """Return the number of neighbours that at most one in 100 such points has by chance."""
    lone, paired = np.count_nonzero(neighbours == 0), np.count_nonzero(neighbours == 1)
    # scattered points have Poisson counts, whose rate is the ratio of their first two frequencies
    rate = paired / lone if lone > 20 else 0.0
    least = MIN_NEIGHBOURS
    # pdtrc: the probability of more, without scipy.stats, which takes long to import
    while (len(neighbours) * pdtrc(least - 1, rate)
           > 0.01 * np.count_nonzero(neighbours >= least) > 0):
        least += 1
    return least
