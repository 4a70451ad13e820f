# SPDX-License-Identifier: Apache-2.0
"""
The fine nodes: the compiled loop where the build spends its time.

For every block the triangles that may be nearest are gathered, for every group of its nodes
narrowed, and measured at all nodes of the group at a time, to choose the one from which the sample
is computed in double precision.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.field.candidates import GROUPS, LANES, gather, measure, narrow
from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.field.triangles import write_sample


@compiled
def fill_blocks(tree, origin, voxel, block_of, cells, distances, nodes, nearest):
    """
    Fill the fine nodes of some blocks, but for those on their far sides that another block has too.

    Parameters
    ----------
    tree : Tree
    origin, voxel, block_of : as in `FieldArrays`
    cells : (n, 3) int64, the coarse cells of the blocks
    distances : (n,) float64, of their centres to the surface
    nodes : (n * NODES**3, 4) float32, filled
    nearest : (n, 2, 2, 2) int32, filled with the triangles nearest to the corners

    """
    # plain arrays pass into the inner loops: those of a tuple are counted in and out every time
    triangle, axes, normal = tree.triangle, tree.axes, tree.normal
    room = len(triangle)
    candidate = np.empty(room, np.int32)
    ball = np.empty((4, room), np.float32)
    corner = np.empty((room, 3), np.float32)
    bound = np.empty(room, np.float32)
    chosen = np.empty(room, np.int32)
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
            _place(voxel, g, lanes)
            measure(axes, candidate, corner, chosen, m, lanes, best)
            _write(triangle, normal, candidate, best, centre, voxel, g, b, nodes, nearest)


@compiled
def copy_far_sides(block_of, cells, first, last, blocks):
    """Copy the far nodes of some blocks (n, NODES, NODES, NODES, 4) from those that filled them."""
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
def _place(voxel, g, lanes):
    """Put the nodes of group ``g``, from the centre of the block, in the ``lanes``."""
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
    """Write the samples of group ``g``, whose nearest candidates are the ``best``."""
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
