# SPDX-License-Identifier: Apache-2.0
"""Subsets of the points that the global search starts from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.downsampling import farthest_point_sample
from gsdf_registration.common.rigid import Array

MIN_DENSITY = 0.9       # of the median number of neighbours
NEAR_SHARE = 0.2        # of the points in a local subset
EXCLUDED_SHARE = 0.4    # of the points that the complement of a local subset leaves out
MIN_SUBSET = 20         # points in a subset, if there are as many


def filter_sparse(points: Array, chosen: NDArray[np.intp], radius: float) -> NDArray[np.bool_]:
    """
    Return a mask of the ``chosen`` points that have about the median number of neighbours, or more.

    A hand moves faster through the air than over a bone, so arcs through the air are sparser.

    Parameters
    ----------
    points : (n, 3) float, metres
    chosen : (m,) int
        Indices of points.
    radius : float, metres
        Neighbours are counted within this distance.

    Returns
    -------
    (m,) bool

    """
    neighbours = cKDTree(points).query_ball_point(points[chosen], radius, return_length=True)
    return neighbours >= MIN_DENSITY * np.median(neighbours)


def local_subsets(points: Array, count: int) -> list[Array]:
    """
    Return all points and, for each of ``count`` seeds, the points near it and the points not near.

    If one other object was touched, some seed lies on it, and the points not near that seed are
    free of it. If several objects were touched, the points near some seed are free of all of them.

    Parameters
    ----------
    points : (n, 3) float

    """
    near = max(round(NEAR_SHARE * len(points)), MIN_SUBSET)
    excluded = max(min(round(EXCLUDED_SHARE * len(points)), len(points) - MIN_SUBSET), 0)
    found = [points]
    for seed in farthest_point_sample(points, count):
        ranked = points[np.argsort(((points - points[seed])**2).sum(axis=1), kind='stable')]
        found += [ranked[:near], ranked[excluded:]]
    return found
