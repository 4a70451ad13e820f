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


def limit_density(points: Array, radius: float, most: int) -> NDArray[np.intp]:
    """
    Return the indices of the points with fewer than ``most`` earlier ones within ``radius``.

    Only the points that are kept count as earlier ones. Where the density is low, all are kept.

    Parameters
    ----------
    points : (n, 3) float, metres, finite
    radius : float, metres
    most : int

    """
    cells, cell = np.unique(np.floor(points / radius), axis=0, return_inverse=True)
    kept = np.zeros(len(points), dtype=np.bool_)
    _limit_density(np.ascontiguousarray(points, dtype=np.float64), cells, cell.ravel(), radius,
                   most, kept)
    return np.flatnonzero(kept)


@compiled
def _limit_density(points: Array, cells: Array, cell: NDArray[np.int64], radius: float, most: int,
                   kept: NDArray[np.bool_]) -> None:
    """Fill ``kept`` (n,); ``cells`` (m, 3) are sorted, ``cell`` (n,) is that of each point."""
    around = np.full((len(cells), 27), -1)
    count = np.zeros(len(cells), np.int64)
    for k in range(len(points)):
        count[cell[k]] += 1
    crowded = np.zeros(len(cells), np.bool_)
    for c in range(len(cells)):
        total = 0
        for j in range(27):
            x, y, z = j // 9 - 1, j // 3 % 3 - 1, j % 3 - 1
            around[c, j] = _find_cell(cells, cells[c, 0] + x, cells[c, 1] + y, cells[c, 2] + z)
            if around[c, j] >= 0:
                total += count[around[c, j]]
        crowded[c] = total > most
    # the points kept of each cell, a linked list from the last to the first
    last, before = np.full(len(cells), -1), np.full(len(points), -1)
    for k in range(len(points)):
        near = 0
        if crowded[cell[k]]:
            for j in range(27):
                c = around[cell[k], j]
                other = last[c] if c >= 0 else -1
                while other >= 0 and near < most:
                    squared = 0.0
                    for i in range(3):
                        squared += (points[k, i] - points[other, i]) ** 2
                    near += squared < radius * radius
                    other = before[other]
        if near < most:
            kept[k] = True
            before[k] = last[cell[k]]
            last[cell[k]] = k


@compiled
def _find_cell(cells: Array, x: float, y: float, z: float) -> int:
    """Return the row of (x, y, z) in the sorted ``cells`` (m, 3) by bisection, or -1."""
    low, high = 0, len(cells)
    while low < high:
        middle = (low + high) // 2
        a, b, c = cells[middle, 0], cells[middle, 1], cells[middle, 2]
        if a < x or (a == x and (b < y or (b == y and c < z))):
            low = middle + 1
        else:
            high = middle
    found = low < len(cells) and cells[low, 0] == x and cells[low, 1] == y and cells[low, 2] == z
    return low if found else -1
