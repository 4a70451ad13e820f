# SPDX-License-Identifier: Apache-2.0
"""
Downsample a point cloud.

The selected points do not depend on a rigid motion of all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.rigid import Array, from_rt, transform


def farthest_point_sample(points: Array, count: int) -> NDArray[np.intp]:
    """
    Return the indices of at most ``count`` points by farthest-point sampling.

    The first few points already span the whole cloud. The order of the input matters only for ties.

    Parameters
    ----------
    points : (n, 3) float

    """
    chosen = np.zeros(min(count, len(points)), dtype=np.intp)
    _farthest_points(np.ascontiguousarray(points, dtype=np.float64), points.mean(axis=0), chosen)
    return chosen


@compiled
def _farthest_points(points: Array, place: Array, chosen: NDArray[np.intp]) -> None:
    """Fill ``chosen`` with the point farthest from ``place``, then from those already chosen."""
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


def voxel_downsample(points: Array, voxel_size: float) -> NDArray[np.intp]:
    """Return the indices of one point per voxel: the point nearest to the centre of the voxel."""
    return voxel_grid(points, voxel_size)[0]


def voxel_grid(points: Array, voxel_size: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """
    Assign points to the voxels of a grid along their principal axes.

    Parameters
    ----------
    points : (n, 3) float, metres
    voxel_size : float, metres

    Returns
    -------
    chosen : (m,) int
        Index of the point nearest to the centre of each voxel that contains points.
    voxel : (n,) int
        Voxel of each point, an index into ``chosen``.

    """
    place = transform(principal_frame(points), points) / voxel_size
    cell = np.floor(place)
    order = np.lexsort((((place - cell - 0.5)**2).sum(axis=1), *cell.T[::-1]))
    first = np.r_[True, (cell[order[1:]] != cell[order[:-1]]).any(axis=1)]
    voxel = np.empty(len(points), dtype=np.intp)
    voxel[order] = np.cumsum(first) - 1
    return order[first], voxel


def principal_frame(points: Array) -> Array:
    """
    Return the rigid motion (4, 4) into the principal frame of points: centroid, principal axes.

    Coordinates in this frame do not change when all points move together.
    """
    centroid = points.mean(axis=0)
    # eigenvectors of the 3 x 3 moments: three axes, even of one or two points
    axes = np.linalg.eigh((points - centroid).T @ (points - centroid))[1].T[::-1].copy()
    # sign of an axis: the third moment along it is positive
    axes *= np.where((((points - centroid) @ axes.T) ** 3).sum(axis=0) < 0.0, -1.0, 1.0)[:, None]
    axes[2] = np.cross(axes[0], axes[1])
    return from_rt(axes, -axes @ centroid)
