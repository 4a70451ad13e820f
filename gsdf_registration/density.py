# SPDX-License-Identifier: Apache-2.0
"""A stroke is dense in space, stray samples are not: which points to look at first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import poisson

from gsdf_registration.rigid import Array

MIN_NEIGHBOURS = 4      # of a point in a stroke: samples 0.3-0.6 mm apart have a dozen and more
MIN_CLUSTER = 12        # points in a stroke
SIFT = 10               # cubes along the radius


def on_strokes(points: Array, radius: float) -> NDArray[np.bool_]:
    """
    Tell which points lie on strokes rather than scattered in space.

    A point counts if more neighbours than chance would give stand within ``radius``, and if it
    belongs to a chain of such points. Where no point does, the points were taken one by one and all
    of them count.

    Parameters
    ----------
    points : (n, 3) float, metres
    radius : float, metres

    Returns
    -------
    (n,) bool

    """
    _, first, cube = np.unique(np.floor(points * (SIFT / radius)).astype(np.int64), axis=0,
                               return_index=True, return_inverse=True)
    sifted = points[first]      # one of each small cube: a resting tip must not slow this down
    tree = cKDTree(sifted)
    neighbours = tree.query_ball_point(sifted, radius, return_length=True) - 1
    dense = neighbours >= _least_neighbours(neighbours)
    if dense.any():
        pairs = cKDTree(sifted[dense]).query_pairs(radius, output_type='ndarray')
        count = int(dense.sum())
        links = coo_matrix((np.ones(len(pairs), dtype=bool), pairs.T), shape=(count, count))
        _, cluster = connected_components(links, directed=False)
        dense[dense] = np.bincount(cluster)[cluster] >= MIN_CLUSTER
    return dense[cube.ravel()] if dense.any() else np.ones(len(points), dtype=bool)


def _least_neighbours(neighbours: NDArray[np.intp]) -> int:
    """Return how many neighbours a point needs so that chance explains at most one in 100 such."""
    lone, paired = np.count_nonzero(neighbours == 0), np.count_nonzero(neighbours == 1)
    # Scattered points have Poisson counts, whose rate is the ratio of their first two frequencies
    rate = paired / lone if lone > 20 else 0.0
    least = MIN_NEIGHBOURS
    while len(neighbours) * poisson.sf(least - 1,
                                       rate) > 0.01 * np.count_nonzero(neighbours >= least) > 0:
        least += 1
    return least


def spread_sample(points: Array, count: int) -> NDArray[np.intp]:
    """
    Return the indices of at most ``count`` points, each as far from those before it as can be.

    Farthest-point sampling: the first few already span the whole.  The order of the points does not
    matter but for ties.

    Parameters
    ----------
    points : (n, 3) float

    """
    chosen = np.zeros(min(count, len(points)), dtype=np.intp)
    far = ((points - points.mean(axis=0)) ** 2).sum(axis=1)
    for i in range(len(chosen)):
        chosen[i] = np.argmax(far)
        squared = ((points - points[chosen[i]]) ** 2).sum(axis=1)
        far = squared if i == 0 else np.minimum(far, squared)
    return chosen


def thinned(points: Array, spacing: float) -> NDArray[np.intp]:
    """
    Return the indices of one point for each cube of edge ``spacing``.

    The one nearest to the mean of its cube.
    """
    _, cube = np.unique(np.floor(points / spacing).astype(np.int64), axis=0, return_inverse=True)
    cube = cube.ravel()
    size = np.bincount(cube)
    mean = np.stack([np.bincount(cube, points[:, a]) / size for a in range(3)], axis=1)
    off = ((points - mean[cube]) ** 2).sum(axis=1)
    order = np.lexsort((off, cube))
    return order[np.r_[True, np.diff(cube[order]) > 0]]


def first_of_each(points: Array) -> NDArray[np.bool_]:
    """
    Tell which of the points (n, 3) are not exact repeats of earlier ones.

    A reading repeated adds nothing.
    """
    first = np.zeros(len(points), dtype=bool)
    first[np.unique(points, axis=0, return_index=True)[1]] = True
    return first
