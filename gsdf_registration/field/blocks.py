# SPDX-License-Identifier: Apache-2.0
"""
Compute the samples at the fine nodes, where the build spends most of its time.

For each block, the triangles that may be nearest to one of its nodes are gathered. For each group
of nodes they are narrowed down, and the nearest triangle of every node is found in single
precision. The sample is then computed from that triangle in double precision.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.field.nearest_triangle import GROUPS, LANES, gather, measure, narrow
from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.field.triangles import write_sample


@compiled
def fill_blocks(tree, origin, voxel, block_of, cells, distances, nodes, nearest):
    """
    Fill the fine nodes of some blocks, except nodes on the far sides that belong to another block.

    Parameters
    ----------
    tree : Tree
    origin, voxel, block_of : see `FieldArrays`
    cells : (n, 3) int64, coarse cells of the blocks
    distances : (n,) float64, m, distance from the centre of each block to the surface
    nodes : (n * NODES**3, 4) float32, output
    nearest : (n, 2, 2, 2) int32, output, the triangle nearest to each corner

    """
    # plain arrays: numba would count a reference for each array of a tuple in every inner call
    triangle, axes, normal = tree.triangle, tree.axes, tree.normal
    capacity = len(triangle)
    candidate = np.empty(capacity, np.int32)
    ball = np.empty((4, capacity), np.float32)
    corner = np.empty((capacity, 3), np.float32)
    bound = np.empty(capacity, np.float32)
    chosen = np.empty(capacity, np.int32)
    lanes = np.zeros(4 * LANES, np.float32)
    best = np.zeros(LANES, np.int32)
    centre = np.empty(3)
    for b in range(len(cells)):
        for a in range(3):
            centre[a] = origin[a] + (cells[b, a] + 0.5) * CELLS * voxel
        reach = (distances[b] + math.sqrt(3.0) * CELLS * voxel) * (1.0 + 1e-6)
        n = gather(tree, centre, reach, candidate, ball, corner)
        for g in range(len(GROUPS)):
            if (GROUPS[g, 3:].max() > CELLS and block_of[cells[b, 0] + GROUPS[g, 0] // CELLS,
                                                         cells[b, 1] + GROUPS[g, 1] // CELLS,
                                                         cells[b, 2] + GROUPS[g, 2] // CELLS] >= 0):
                continue
            m = narrow(triangle, candidate, ball, n, centre, voxel, g, bound, chosen)
            _set_positions(voxel, g, lanes)
            measure(axes, candidate, corner, chosen, m, lanes, best)
            _write(triangle, normal, candidate, best, centre, voxel, g, b, nodes, nearest)


@compiled
def copy_far_sides(block_of, cells, first, last, blocks):
    """Copy the nodes on the far sides of ``blocks`` from the blocks to which they belong."""
    for b in range(first, last):
        for g in range(len(GROUPS)):
            if GROUPS[g, 3:].max() == CELLS:
                continue
            owner = block_of[cells[b, 0] + GROUPS[g, 0] // CELLS,
                             cells[b, 1] + GROUPS[g, 1] // CELLS,
                             cells[b, 2] + GROUPS[g, 2] // CELLS]
            if owner < 0:
                continue
            for i in range(GROUPS[g, 0], GROUPS[g, 3]):
                for j in range(GROUPS[g, 1], GROUPS[g, 4]):
                    for k in range(GROUPS[g, 2], GROUPS[g, 5]):
                        for a in range(4):
                            blocks[b, i, j, k, a] = blocks[owner, i % CELLS, j % CELLS, k % CELLS,
                                                           a]


@compiled
def _set_positions(voxel, g, lanes):
    """Write the positions of the nodes of group ``g`` relative to the block centre to ``lanes``."""
    lane = 0
    for i in range(GROUPS[g, 0], GROUPS[g, 3]):
        for j in range(GROUPS[g, 1], GROUPS[g, 4]):
            for k in range(GROUPS[g, 2], GROUPS[g, 5]):
                lanes[lane] = (i - 0.5 * CELLS) * voxel
                lanes[LANES + lane] = (j - 0.5 * CELLS) * voxel
                lanes[2 * LANES + lane] = (k - 0.5 * CELLS) * voxel
                lane += 1


@compiled
def _write(triangle, normal, candidate, best, centre, voxel, g, block, nodes, nearest):
    """Write the samples of group ``g``; ``best`` are its nearest candidates."""
    lane = 0
    for i in range(GROUPS[g, 0], GROUPS[g, 3]):
        x = centre[0] + (i - 0.5 * CELLS) * voxel
        for j in range(GROUPS[g, 1], GROUPS[g, 4]):
            y = centre[1] + (j - 0.5 * CELLS) * voxel
            for k in range(GROUPS[g, 2], GROUPS[g, 5]):
                z = centre[2] + (k - 0.5 * CELLS) * voxel
                t = candidate[best[lane]]
                lane += 1
                write_sample(triangle, normal, t, x, y, z, 1e-6 * voxel, nodes,
                             ((block * NODES + i) * NODES + j) * NODES + k)
                if i % CELLS == 0 and j % CELLS == 0 and k % CELLS == 0:
                    nearest[block, i // CELLS, j // CELLS, k // CELLS] = t
