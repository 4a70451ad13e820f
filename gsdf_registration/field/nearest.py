# SPDX-License-Identifier: Apache-2.0
"""
The triangle nearest to each fine node: the compiled loop where the build spends its time.

The triangle nearest to any point of a ball lies within dmin + 2 R of its centre (dmin: distance of the centre to the surface, R: radius of the
ball).  So the candidates of a block are gathered once, narrowed for every 2 x 2 x 2 of its nodes, and of those a node measures only
the ones whose bounding disc is nearer than the best so far, some three to five.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np

from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.field.triangles import distance2, write_sample

_f = np.float32


class Candidates(NamedTuple):
    """
    Scratch: triangles that may be nearest.

    disc : (7, room) float32, centre (from that of the block), radius and normal of their bounding discs
    triangle : (room,) int32
    bound : (room,) float32, lower bounds of squared distances
    """

    disc: np.ndarray
    triangle: np.ndarray
    bound: np.ndarray


@nb.njit(nogil=True, cache=True)
def _scratch(room):
    return Candidates(np.empty((7, room), np.float32), np.empty(room, np.int32), np.empty(room, np.float32))


@nb.njit(nogil=True, cache=True)
def _gather(tree, x, y, z, radius, out):
    """Put all triangles that may lie within ``radius`` of (x, y, z) into ``out`` and return their number."""
    leaves = len(tree.start) - 1
    stack = np.empty(64, np.int64)
    stack[0] = 1
    top = 1
    n = 0
    while top > 0:
        top -= 1
        node = stack[top]
        dx = max(tree.box[node, 0] - x, 0.0, x - tree.box[node, 3])
        dy = max(tree.box[node, 1] - y, 0.0, y - tree.box[node, 4])
        dz = max(tree.box[node, 2] - z, 0.0, z - tree.box[node, 5])
        if dx * dx + dy * dy + dz * dz > radius * radius:
            continue
        if node < leaves:
            stack[top] = 2 * node + 1
            stack[top + 1] = 2 * node
            top += 2
            continue
        for t in range(tree.start[node - leaves], tree.start[node - leaves + 1]):
            dx = tree.disc[t, 0] - x
            dy = tree.disc[t, 1] - y
            dz = tree.disc[t, 2] - z
            r = radius + tree.disc[t, 3]
            if dx * dx + dy * dy + dz * dz <= r * r:
                out.disc[0, n] = dx
                out.disc[1, n] = dy
                out.disc[2, n] = dz
                out.disc[3, n] = tree.disc[t, 3]
                for a in range(3):
                    out.disc[4 + a, n] = tree.normal[t, 0, a]
                out.triangle[n] = t
                n += 1
    return n


@nb.njit(nogil=True, cache=True, fastmath=True)
def _disc_bounds(disc, n, x, y, z, bound):
    """Fill ``bound`` (n,) with the squared distances from (x, y, z) to the discs; one vector loop."""
    zero = _f(0.0)
    for k in range(n):
        dx = disc[0, k] - x
        dy = disc[1, k] - y
        dz = disc[2, k] - z
        height = dx * disc[4, k] + dy * disc[5, k] + dz * disc[6, k]
        side2 = dx * dx + dy * dy + dz * dz - height * height
        beyond = np.sqrt(side2 if side2 > zero else zero) - disc[3, k]
        beyond = beyond if beyond > zero else zero
        bound[k] = height * height + beyond * beyond


@nb.njit(nogil=True, cache=True, forceinline=True)
def _nearest(tree, candidates, n, centre, x, y, z, guess):
    """Return the candidate nearest to (x, y, z) and its squared distance; leaves all their bounds behind."""
    _disc_bounds(candidates.disc, n, _f(x - centre[0]), _f(y - centre[1]), _f(z - centre[2]), candidates.bound)
    best = distance2(tree.triangle, guess, x, y, z)
    for c in range(n):
        if candidates.bound[c] < best:
            d2 = distance2(tree.triangle, candidates.triangle[c], x, y, z)
            if d2 < best:
                best = d2
                guess = candidates.triangle[c]
    return guess, best


@nb.njit(nogil=True, cache=True, forceinline=True)
def _narrow(candidates, n, limit, chosen, out):
    """Put the candidates whose bound is at most ``limit`` into ``out`` and return their number; ``chosen``: scratch (room,)."""
    m = 0
    for c in range(n):      # written every time, counted if it fits: no branch to mispredict
        chosen[m] = c
        m += candidates.bound[c] <= limit
    for a in range(7):
        for c in range(m):
            out.disc[a, c] = candidates.disc[a, chosen[c]]
    for c in range(m):
        out.triangle[c] = candidates.triangle[chosen[c]]
    return m


@nb.njit(nogil=True, cache=True)
def fill_blocks(tree, origin, voxel, block_of, cells, seeds, distances, nodes, nearest):
    """
    Fill the fine nodes of some blocks, but for those on their far faces that belong to another block.

    Parameters
    ----------
    tree : Tree
    origin, voxel, block_of : as in `FieldArrays`
    cells : (n, 3) int64, the coarse cells of the blocks
    seeds, distances : (n,), the triangle nearest to the centre and its distance
    nodes : (n * NODES**3, 4) float32, filled
    nearest : (n, 2, 2, 2) int32, filled with the triangles nearest to the corners

    """
    near = _scratch(len(tree.triangle))
    few = _scratch(len(tree.triangle))
    chosen = np.empty(len(tree.triangle), np.int32)
    centre = np.empty(3)
    for b in range(len(cells)):
        ci, cj, ck = cells[b]
        for a in range(3):
            centre[a] = origin[a] + (cells[b, a] + 0.5) * CELLS * voxel
        radius = distances[b] + math.sqrt(3.0) * CELLS * voxel
        n = _gather(tree, centre[0], centre[1], centre[2], radius * (1.0 + 1e-6), near)
        last = seeds[b]
        for g in range(27):     # pairs of nodes along each axis; the third is the one on the far face
            gi, gj, gk = g // 9, g // 3 % 3, g % 3
            if g > 0 and block_of[ci + gi // 2, cj + gj // 2, ck + gk // 2] >= 0 and (gi == 2 or gj == 2 or gk == 2):
                continue
            last = _fill_group(tree, near, n, few, chosen, centre, voxel, 2 * gi, 2 * gj, 2 * gk, last, b, nodes, nearest)


@nb.njit(nogil=True, cache=True, forceinline=True)
def _fill_group(tree, near, n, few, chosen, centre, voxel, i0, j0, k0, last, block, nodes, nearest):
    """Fill the nodes of a block from (i0, j0, k0) on, two along an axis as far as there are; return the last triangle."""
    first = block * NODES**3
    i1, j1, k1 = min(i0 + 2, NODES), min(j0 + 2, NODES), min(k0 + 2, NODES)
    half = 0.5 * (NODES - 1)
    last, d2 = _nearest(tree, near, n, centre, centre[0] + (0.5 * (i0 + i1 - 1) - half) * voxel,
                        centre[1] + (0.5 * (j0 + j1 - 1) - half) * voxel,
                        centre[2] + (0.5 * (k0 + k1 - 1) - half) * voxel, last)
    diagonal = voxel * math.sqrt((i1 - i0 - 1) ** 2 + (j1 - j0 - 1) ** 2 + (k1 - k0 - 1) ** 2)
    m = _narrow(near, n, (math.sqrt(d2) + diagonal) ** 2 * (1.0 + 1e-5), chosen, few)
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                x = centre[0] + (i - half) * voxel
                y = centre[1] + (j - half) * voxel
                z = centre[2] + (k - half) * voxel
                last, _ = _nearest(tree, few, m, centre, x, y, z, last)
                write_sample(tree, last, x, y, z, 1e-6 * voxel, nodes, first + (i * NODES + j) * NODES + k)
                if i % CELLS == 0 and j % CELLS == 0 and k % CELLS == 0:
                    nearest[block, i // CELLS, j // CELLS, k // CELLS] = last
    return last


@nb.njit(nogil=True, cache=True)
def copy_far_faces(block_of, cells, blocks):
    """Copy the far nodes of every block from the blocks they belong to."""
    for b in range(len(cells)):
        ci, cj, ck = cells[b]
        for i in range(NODES):
            for j in range(NODES):
                for k in range(NODES):
                    if max(i, j, k) == CELLS:
                        owner = block_of[ci + i // CELLS, cj + j // CELLS, ck + k // CELLS]
                        if owner >= 0:
                            blocks[b, i, j, k] = blocks[owner, i % CELLS, j % CELLS, k % CELLS]
