# SPDX-License-Identifier: Apache-2.0
"""The nodes and the surface sample of a triangle mesh."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.field.blocks import copy_far_sides, fill_blocks
from gsdf_registration.field.coarse import fill_coarse, mark_cells, spread
from gsdf_registration.field.grid import Grid, Nodes
from gsdf_registration.field.sample import CELLS, FieldArrays
from gsdf_registration.field.surface import sample_triangles
from gsdf_registration.field.tree import build_tree

# Work is shared out in pieces that do not overlap and do not depend on the number of threads:
BLOCKS = 256    # at a time
LAYERS = 8      # of the coarse grid at a time
ROUNDS = 3      # along the three axes; after them distances 20 mm off are within 0.05 mm RMS


def fill_from_mesh(grid: Grid, vertices: Array, faces: np.ndarray,
                   threads: int) -> tuple[FieldArrays, np.ndarray, np.ndarray]:
    """
    Return the nodes of a mesh, and points and normals of its surface (k, 3) float32.

    Parameters
    ----------
    grid : Grid
    vertices : (n, 3) float64
    faces : (m, 3) int32
    threads : int

    """
    tree = build_tree(vertices, faces)
    with ThreadPoolExecutor(threads) as pool:
        def share(n: int, size: int, work: Callable[[int, int], None]) -> None:
            """Call ``work`` with first and last of every piece of range(n)."""
            list(pool.map(lambda first: work(first, min(first + size, n)), range(0, n, size)))

        # Find the blocks
        distance = np.full(grid.shape, np.inf)
        share(grid.shape[0], LAYERS,
              lambda i, j: mark_cells(tree, grid.origin, grid.edge, grid.reach, i, j, distance))
        nodes = grid.allocate(distance)
        # Fill them
        block_of, cells = nodes.arrays.block_of, nodes.cells
        of_centre = distance[tuple(cells.T)]
        nearest = np.full((len(cells), 2, 2, 2), -1, dtype=np.int32)
        share(len(cells), BLOCKS, lambda i, j: fill_blocks(
            tree, grid.origin, grid.voxel, block_of, cells[i:j], of_centre[i:j],
            nodes.blocks[i:j].reshape(-1, 4), nearest[i:j]))
        share(len(cells), BLOCKS, lambda i, j: copy_far_sides(block_of, cells, i, j, nodes.blocks))
        # Spread what their corners know over the coarse grid
        known, distance2s = _known_at_corners(nodes, nearest)
        for axis in ROUNDS * (0, 1, 2):
            share(known.shape[(axis + 1) % 3], LAYERS,
                  lambda i, j, axis=axis: spread(  # type: ignore[misc]
                      tree, grid.origin, grid.edge, axis, i, j, known, distance2s))
        share(
            len(known), LAYERS, lambda i, j: fill_coarse(tree, grid.origin, grid.edge, known, i, j,
                                                         nodes.coarse.reshape(-1, 4)))
    return nodes.arrays, *sample_triangles(tree)


def _known_at_corners(nodes: Nodes, nearest: np.ndarray) -> tuple[np.ndarray, Array]:
    """Return each coarse node's nearest triangle and its squared distance, as blocks know them."""
    shape = nodes.coarse.shape[:3]
    known = np.full(shape, -1, dtype=np.int32)
    distance2s = np.full(shape, np.inf)
    for i, j, k in np.ndindex(2, 2, 2):
        filled = nearest[:, i, j, k] >= 0
        at = tuple((nodes.cells[filled] + (i, j, k)).T)
        known[at] = nearest[filled, i, j, k]
        distance2s[at] = nodes.blocks[filled, CELLS * i, CELLS * j, CELLS * k,
                                      0].astype(np.float64)**2
    return known, distance2s
