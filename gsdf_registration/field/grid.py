# SPDX-License-Identifier: Apache-2.0
"""Where the nodes of a field are: a coarse grid round the surface, some of its cells divided."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field.sample import CELLS, NODES, FieldArrays

BAND = 3.0              # half width of the band round the surface that is divided, voxels
MARGIN = 3              # coarse cells round the surface
LARGEST_GRID = 2**26    # coarse nodes: 1 GB


@dataclass(frozen=True)
class Nodes:
    """
    Room for all nodes of a field, to be filled through the views.

    arrays : FieldArrays
    cells : (n, 3) int64, the coarse cells that are divided into blocks
    blocks : (n, NODES, NODES, NODES, 4) float32, a view
    coarse : (bx + 1, by + 1, bz + 1, 4) float32, a view
    """

    arrays: FieldArrays
    cells: np.ndarray
    blocks: np.ndarray
    coarse: np.ndarray


@dataclass(frozen=True)
class Grid:
    """The coarse grid: ``shape`` cells from ``origin`` on, m, each CELLS voxels wide."""

    origin: Array
    shape: tuple[int, ...]
    voxel: float

    @classmethod
    def around(cls, bounds: Array, voxel: float) -> Grid:
        """
        Return the grid round a bounding box (2, 3), its nodes at whole multiples of their spacing.

        Raises
        ------
        InputError
            If it were too large.

        """
        low = np.floor(bounds[0] / (CELLS * voxel)).astype(np.int64) - MARGIN
        high = np.ceil(bounds[1] / (CELLS * voxel)).astype(np.int64) + MARGIN
        shape = tuple((high - low).tolist())
        if math.prod(n + 1 for n in shape) > LARGEST_GRID:
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
        """How far from the surface the centre of a cell with points in the band can be, m."""
        return (BAND + 0.5 * math.sqrt(3.0) * CELLS) * self.voxel

    def allocate(self, distance: Array) -> Nodes:
        """Return room for the nodes, given the cell centres' ``distance`` to the surface."""
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
