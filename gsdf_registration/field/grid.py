# SPDX-License-Identifier: Apache-2.0
"""The grid of a field: coarse cells around the bone, those near the surface divided into blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field.sample import CELLS, NODES, FieldArrays

BAND = 3.0              # voxels, half width of the band around the surface with fine nodes
MARGIN = 3              # coarse cells around the bounding box
MAX_NODES = 2**26       # coarse nodes: 1 GB


@dataclass(frozen=True)
class Nodes:
    """
    All nodes of a field, with views for writing them.

    arrays : FieldArrays
    cells : (n, 3) int64, the coarse cells that have a block of fine nodes
    blocks : (n, NODES, NODES, NODES, 4) float32, a view
    coarse : (bx + 1, by + 1, bz + 1, 4) float32, a view
    """

    arrays: FieldArrays
    cells: np.ndarray
    blocks: np.ndarray
    coarse: np.ndarray


@dataclass(frozen=True)
class Grid:
    """The coarse grid: ``shape`` cells of CELLS voxels, with its lower corner at ``origin``, m."""

    origin: Array
    shape: tuple[int, ...]
    voxel: float

    @classmethod
    def around(cls, bounds: Array, voxel: float) -> Grid:
        """
        Return the grid around a bounding box (2, 3), m, with nodes at multiples of their spacing.

        Raises
        ------
        InputError
            If the grid would be too large.

        """
        low = np.floor(bounds[0] / (CELLS * voxel)).astype(np.int64) - MARGIN
        high = np.ceil(bounds[1] / (CELLS * voxel)).astype(np.int64) + MARGIN
        shape = tuple((high - low).tolist())
        if math.prod(n + 1 for n in shape) > MAX_NODES:
            raise InputError(
                f'voxels of {voxel * 1e3:g} mm are too small for a bone of '
                f'{np.ptp(bounds, axis=0).max() * 1e3:.0f} mm; choose a larger voxel size')
        return cls(low * (CELLS * voxel), shape, voxel)

    @property
    def edge(self) -> float:
        """The width of a cell, m."""
        return CELLS * self.voxel

    @property
    def reach(self) -> float:
        """Largest distance from the surface to the centre of a cell that intersects the band, m."""
        return (BAND + 0.5 * math.sqrt(3.0) * CELLS) * self.voxel

    def allocate(self, distance: Array) -> Nodes:
        """Allocate the nodes, given the ``distance`` from the cell centres to the surface."""
        divided = np.abs(distance) <= self.reach
        cells = np.argwhere(divided)
        block_of = np.full(self.shape, -1, dtype=np.int32)
        block_of[divided] = np.arange(len(cells), dtype=np.int32)
        coarse_shape = [n + 1 for n in self.shape]
        first_coarse = len(cells) * NODES**3
        nodes = np.empty((first_coarse + math.prod(coarse_shape), 4), dtype=np.float32)
        return Nodes(FieldArrays(self.origin, self.voxel, block_of, nodes, first_coarse), cells,
                     nodes[:first_coarse].reshape(-1, NODES, NODES, NODES, 4),
                     nodes[first_coarse:].reshape(*coarse_shape, 4))
