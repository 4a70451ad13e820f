# SPDX-License-Identifier: Apache-2.0
"""Compute the nodes and the surface sample of a point cloud, each point extended to a disc."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration.common.rigid import Array
from gsdf_registration.field.grid import Grid
from gsdf_registration.field.sample import NODES, FieldArrays
from gsdf_registration.field.surface import downsample

BLOCKS = 256    # blocks computed at a time, which limits the memory


def fill_from_cloud(grid: Grid, points: Array, normals: Array,
                    threads: int) -> tuple[FieldArrays, np.ndarray, np.ndarray]:
    """
    Return the nodes, and points and normals (k, 3) float32 of the surface.

    Parameters
    ----------
    grid : Grid
    points : (n, 3) float64
    normals : (n, 3) float64, unit length, outward
    threads : int

    """
    discs = Discs(points, normals, threads)
    centres = _indices(grid.shape) + 0.5
    nodes = grid.allocate(discs.sample(grid.origin + grid.edge * centres)[..., 0])
    steps = grid.voxel * _indices((NODES, NODES, NODES))
    for first in range(0, len(nodes.cells), BLOCKS):
        corners = grid.origin + grid.edge * nodes.cells[first:first + BLOCKS, None, None, None]
        nodes.blocks[first:first + BLOCKS] = discs.sample(corners + steps)
    nodes.coarse[:] = discs.sample(grid.origin + grid.edge * _indices(nodes.coarse.shape[:3]))
    return nodes.arrays, *downsample(points, normals)


def _indices(shape: tuple[int, ...]) -> np.ndarray:
    """Return the index of every element of an array, (*shape, 3)."""
    return np.moveaxis(np.indices(shape), 0, -1)


class Discs:
    """
    Discs around the points of a cloud, which cover the surface between them.

    Parameters
    ----------
    points : (n, 3) float64
    normals : (n, 3) float64, unit length, outward
    threads : int

    """

    def __init__(self, points: Array, normals: Array, threads: int) -> None:
        self._tree = cKDTree(points)
        self._normals = normals
        self._threads = threads
        # up to the sixth neighbour: neighbouring discs overlap, but holes of the cloud are kept
        self._radii = self._tree.query(points, k=[min(7, len(points))], workers=threads)[0][:, 0]

    def sample(self, x: Array) -> np.ndarray:
        """Return distance and gradient (..., 4) float32 at ``x`` (..., 3) from the nearest disc."""
        _, nearest = self._tree.query(x, workers=self._threads)
        offset = x - self._tree.data[nearest]
        normal = self._normals[nearest]
        height = np.einsum('...i,...i->...', offset, normal)
        side = offset - height[..., None] * normal
        length = np.linalg.norm(side, axis=-1)
        # share of the in-plane offset that is beyond the rim
        beyond = np.maximum(length - self._radii[nearest], 0.0) / np.where(
            length > 0.0, length, 1.0)
        to_disc = height[..., None] * normal + beyond[..., None] * side
        distance = np.copysign(np.linalg.norm(to_disc, axis=-1), height)
        # on the disc the direction is undefined: use the normal
        near = np.abs(distance) < 1e-6 * self._radii[nearest]
        gradient = np.where(near[..., None], normal,
                            to_disc / np.where(near, 1.0, distance)[..., None])
        return np.concatenate([distance[..., None], gradient], axis=-1).astype(np.float32)
