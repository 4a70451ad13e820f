# SPDX-License-Identifier: Apache-2.0
"""A stroke is dense in space, stray samples are not: which points to look at first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import poisson

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.rigid import Array, from_rt, transform

MIN_NEIGHBOURS = 4      # of a point in a stroke: samples 0.3-0.6 mm apart have a dozen and more
MIN_CLUSTER = 12        # points in a stroke
SIFT = 10               # cubes along the radius
CROWDED = 0.9           # of the median count of neighbours
NEAREST, LEFT_OUT = 0.2, 0.4    # shares of the points that make a part, or are kept out of one
LEAST = 20              # points in a part, if there are so many


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
    # one of each small cube: a resting tip must not slow this down
    chosen, cube = _one_a_cube(points, radius / SIFT)
    sifted = points[chosen]
    tree = cKDTree(sifted)
    neighbours = tree.query_ball_point(sifted, radius, return_length=True) - 1
    dense = neighbours >= _least_neighbours(neighbours)
    if dense.any():
        pairs = cKDTree(sifted[dense]).query_pairs(radius, output_type='ndarray')
        count = int(dense.sum())
        links = coo_matrix((np.ones(len(pairs), dtype=bool), pairs.T), shape=(count, count))
        _, cluster = connected_components(links, directed=False)
        dense[dense] = np.bincount(cluster)[cluster] >= MIN_CLUSTER
    return dense[cube] if dense.any() else np.ones(len(points), dtype=bool)


def filter_isolated(points: Array, radius: float) -> NDArray[np.bool_]:
    """
    Tell which points (n, 3) a registration uses: those `on_strokes`, each once.

    The rest is strewn interference or a reading repeated.
    """
    return np.asarray(on_strokes(points, radius) & (first_duplicate(points) == np.arange(len(points))))


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


def crowded(points: Array, chosen: NDArray[np.intp], radius: float) -> NDArray[np.bool_]:
    """
    Tell which of the ``chosen`` points have about as many others within ``radius`` as most have.

    A hand moves faster through the air than over a bone, so its arcs there are thinner.

    Parameters
    ----------
    points : (n, 3) float, metres
    chosen : (m,) int

    Returns
    -------
    (m,) bool

    """
    neighbours = cKDTree(points).query_ball_point(points[chosen], radius, return_length=True)
    return neighbours >= CROWDED * np.median(neighbours)


def farthest_point_sample(points: Array, count: int) -> NDArray[np.intp]:
    """
    Return the indices of at most ``count`` points, each as far from those before it as can be.

    Farthest-point sampling: the first few already span the whole.  The order of the points does not
    matter but for ties.

    Parameters
    ----------
    points : (n, 3) float

    """
    chosen = np.zeros(min(count, len(points)), dtype=np.intp)
    _spread(np.ascontiguousarray(points, dtype=np.float64), points.mean(axis=0), chosen)
    return chosen


@compiled
def _spread(points: Array, place: Array, chosen: NDArray[np.intp]) -> None:
    """Fill ``chosen`` with the point farthest from ``place``, then from the chosen ones."""
    far = np.full(len(points), np.inf)
    for i in range(len(chosen)):
        farthest = 0
        for k in range(len(points)):
            squared = ((points[k, 0] - place[0]) ** 2 + (points[k, 1] - place[1]) ** 2
                       + (points[k, 2] - place[2]) ** 2)
            far[k] = squared if i < 2 else min(far[k], squared)
            if far[k] > far[farthest]:
                farthest = k
        chosen[i] = farthest
        place = points[farthest]


def voxel_downsample(points: Array, spacing: float) -> NDArray[np.intp]:
    """
    Return the indices of one point for each cube of edge ``spacing``.

    The one nearest to the middle of its cube.
    """
    return _one_a_cube(points, spacing)[0]


def parts(points: Array, count: int) -> list[Array]:
    """
    Return all points and, round each of ``count`` places, the nearest, and all but the nearest.

    Where one other thing was touched, some place lies on it and the rest is free of it; where there
    are several, what lies nearest to some place is.

    Parameters
    ----------
    points : (n, 3) float

    """
    near = max(round(NEAREST * len(points)), LEAST)
    left = max(min(round(LEFT_OUT * len(points)), len(points) - LEAST), 0)
    found = [points]
    for seed in farthest_point_sample(points, count):
        ranked = points[np.argsort(((points - points[seed])**2).sum(axis=1), kind='stable')]
        found += [ranked[:near], ranked[left:]]
    return found


def principal_frame(points: Array) -> Array:
    """
    Return the rigid motion (4, 4) into the points' own frame: centroid, principal axes.

    Whatever is done in that frame does not change when all points are moved together.
    """
    centre = points.mean(axis=0)
    # of the 3 x 3 moments, so that there are three axes however few the points
    axes = np.linalg.eigh((points - centre).T @ (points - centre))[1].T[::-1].copy()
    # the sign of an axis: the longer tail lies on its positive side
    axes *= np.where((((points - centre) @ axes.T) ** 3).sum(axis=0) < 0.0, -1.0, 1.0)[:, None]
    axes[2] = np.cross(axes[0], axes[1])
    return from_rt(axes, -axes @ centre)


def _one_a_cube(points: Array, edge: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return a point of each cube along the points' own axes, and the cube of each point."""
    place = transform(principal_frame(points), points) / edge
    cell = np.floor(place)
    order = np.lexsort((((place - cell - 0.5)**2).sum(axis=1), *cell.T[::-1]))
    first = np.r_[True, (cell[order[1:]] != cell[order[:-1]]).any(axis=1)]
    cube = np.empty(len(points), dtype=np.intp)
    cube[order] = np.cumsum(first) - 1
    return order[first], cube


def first_duplicate(points: Array) -> NDArray[np.intp]:
    """Return of each of the points (n, 3) the index of the first that is exactly the same."""
    x = np.sort(points[:, 0])
    if not (x[1:] == x[:-1]).any():     # as a rule, and soon seen
        return np.arange(len(points))
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[same.ravel()])
