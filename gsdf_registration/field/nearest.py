# SPDX-License-Identifier: Apache-2.0
"""
The triangle nearest to each fine node: the compiled loop where the build spends its time.

The triangle nearest to any point of a ball lies within dmin + 2 R of its centre (dmin: distance of the centre
to the surface, R: radius of the ball).  So the candidates of a block are gathered once, narrowed for every group
of its nodes by their bounding discs, and the rest is measured at all nodes of the group at a time, in the
lanes of the vector unit.  These are single-precision distances within a few millimetres, good to a nanometre:
they choose the triangle, from which the sample is then computed in double precision.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np

from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.field.triangles import distance2, write_sample

LANES = 16      # nodes of a group, at most

_f = np.float32
_compiled = nb.njit(nogil=True, cache=True)
_inline = nb.njit(nogil=True, cache=True, forceinline=True)
_vector = nb.njit(nogil=True, cache=True, fastmath=True)


class Candidates(NamedTuple):
    """
    Triangles that may be nearest to a node of the block, with room for all; positions from the block's centre.

    triangle : (room,) int32
    disc : (7, room) float32, centre, radius and normal of their bounding discs
    corner : (room, 3) float32, corner a in the axes of the triangle
    bound : (room,) float32, lower bounds of squared distances to a point
    chosen : (room,) int32, the ones that may be nearest to a node of the group
    """

    triangle: np.ndarray
    disc: np.ndarray
    corner: np.ndarray
    bound: np.ndarray
    chosen: np.ndarray


@_compiled
def fill_blocks(tree, origin, voxel, block_of, cells, distances, nodes, nearest):
    """
    Fill the fine nodes of some blocks, but for those on their far faces that another block has too.

    Parameters
    ----------
    tree : Tree
    origin, voxel, block_of : as in `FieldArrays`
    cells : (n, 3) int64, the coarse cells of the blocks
    distances : (n,) float64, of their centres to the surface
    nodes : (n * NODES**3, 4) float32, filled
    nearest : (n, 2, 2, 2) int32, filled with the triangles nearest to the corners

    """
    room = len(tree.triangle)
    near = Candidates(np.empty(room, np.int32), np.empty((7, room), np.float32), np.empty((room, 3), np.float32),
                      np.empty(room, np.float32), np.empty(room, np.int32))
    lanes = np.zeros(4 * LANES, np.float32)
    best = np.zeros(LANES, np.int32)
    centre = np.empty(3)
    for b in range(len(cells)):
        for a in range(3):
            centre[a] = origin[a] + (cells[b, a] + 0.5) * CELLS * voxel
        n = _gather(tree, centre, (distances[b] + math.sqrt(3.0) * CELLS * voxel) * (1.0 + 1e-6), near)
        for o in range(8):      # the nodes that belong to this block, then those of the blocks beyond
            oi, oj, ok = o >> 2, o >> 1 & 1, o & 1
            if o > 0 and block_of[cells[b, 0] + oi, cells[b, 1] + oj, cells[b, 2] + ok] >= 0:
                continue
            step = 2 if o == 0 else CELLS
            for j in range(CELLS * oj, CELLS + oj, step):
                for k in range(CELLS * ok, CELLS + ok, step):
                    _fill_group(tree, near, n, centre, voxel, CELLS * oi, j, k, CELLS + oi, min(j + step, CELLS + oj),
                                min(k + step, CELLS + ok), lanes, best, b, nodes, nearest)


@_compiled
def copy_far_faces(block_of, cells, blocks):
    """Copy the far nodes of every block (n, NODES, NODES, NODES, 4) from the ones that have filled them."""
    for b in range(len(cells)):
        for i in range(NODES):
            for j in range(NODES):
                for k in range(NODES):
                    if max(i, j, k) < CELLS:
                        continue
                    owner = block_of[cells[b, 0] + i // CELLS, cells[b, 1] + j // CELLS,
                                     cells[b, 2] + k // CELLS]
                    if owner >= 0:
                        for a in range(4):
                            blocks[b, i, j, k, a] = blocks[owner, i % CELLS, j % CELLS, k % CELLS, a]


@_compiled
def _gather(tree, centre, radius, near):
    """Put all triangles that may lie within ``radius`` of ``centre`` into ``near`` and return their number."""
    box, start, triangle, disc, axes = tree.box, tree.start, tree.triangle, tree.disc, tree.axes
    candidate, near_disc, near_corner = near.triangle, near.disc, near.corner
    leaves = len(start) - 1
    stack = np.empty(64, np.int64)
    stack[0] = 1
    top = 1
    n = 0
    while top > 0:
        top -= 1
        node = stack[top]
        d2 = 0.0
        for a in range(3):
            d2 += max(box[node, a] - centre[a], 0.0, centre[a] - box[node, 3 + a]) ** 2
        if d2 > radius * radius:
            continue
        if node < leaves:
            stack[top] = 2 * node + 1
            stack[top + 1] = 2 * node
            top += 2
            continue
        for t in range(start[node - leaves], start[node - leaves + 1]):
            x = disc[t, 0] - centre[0]
            y = disc[t, 1] - centre[1]
            z = disc[t, 2] - centre[2]
            if x * x + y * y + z * z <= (radius + disc[t, 3]) ** 2:
                candidate[n] = t
                near_disc[0, n] = x
                near_disc[1, n] = y
                near_disc[2, n] = z
                near_disc[3, n] = disc[t, 3]
                x = triangle[t, 0] - centre[0]
                y = triangle[t, 1] - centre[1]
                z = triangle[t, 2] - centre[2]
                for a in range(3):
                    near_disc[4 + a, n] = axes[t, 6 + a]
                    near_corner[n, a] = (axes[t, 3 * a] * x + axes[t, 3 * a + 1] * y
                                         + axes[t, 3 * a + 2] * z)
                n += 1
    return n


@_inline
def _fill_group(tree, near, n, centre, voxel, i0, j0, k0, i1, j1, k1, lanes, best, block, nodes, nearest):
    """Fill the nodes of a block from (i0, j0, k0) to before (i1, j1, k1)."""
    triangle, normal, candidate = tree.triangle, tree.normal, near.triangle
    half = 0.5 * CELLS
    lane = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                lanes[lane] = (i - half) * voxel
                lanes[LANES + lane] = (j - half) * voxel
                lanes[2 * LANES + lane] = (k - half) * voxel
                lane += 1
    m = _narrow(tree, near, n, centre, (0.5 * (i0 + i1 - 1) - half) * voxel, (0.5 * (j0 + j1 - 1) - half) * voxel,
                (0.5 * (k0 + k1 - 1) - half) * voxel,
                voxel * math.sqrt((i1 - i0 - 1) ** 2 + (j1 - j0 - 1) ** 2 + (k1 - k0 - 1) ** 2))
    _measure(tree.axes, near.triangle, near.corner, near.chosen, m, lanes, best)
    lane = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                t = candidate[best[lane]]
                write_sample(triangle, normal, t, centre[0] + (i - half) * voxel, centre[1] + (j - half) * voxel,
                             centre[2] + (k - half) * voxel, 1e-6 * voxel, nodes,
                             ((block * NODES + i) * NODES + j) * NODES + k)
                if i % CELLS == 0 and j % CELLS == 0 and k % CELLS == 0:
                    nearest[block, i // CELLS, j // CELLS, k // CELLS] = t
                lane += 1


@_inline
def _narrow(tree, near, n, centre, x, y, z, diagonal):
    """Choose the candidates that may be nearest within half of ``diagonal`` of (x, y, z); return their number."""
    _disc_bounds(near.disc, n, _f(x), _f(y), _f(z), near.bound)
    bound, chosen = near.bound, near.chosen
    least = 0
    for c in range(n):
        if bound[c] < bound[least]:
            least = c
    dmin = math.sqrt(distance2(tree.triangle, near.triangle[least], centre[0] + x, centre[1] + y, centre[2] + z))
    limit = _f((dmin + diagonal) ** 2 * (1.0 + 1e-5))
    m = 0
    for c in range(n):      # written every time, counted if it fits: no branch to mispredict
        chosen[m] = c
        m += bound[c] <= limit
    return m


@_vector
def _disc_bounds(disc, n, x, y, z, bound):
    """Fill ``bound`` (n,) with the squared distances from (x, y, z) to the discs."""
    zero = _f(0.0)
    for c in range(n):
        dx = disc[0, c] - x
        dy = disc[1, c] - y
        dz = disc[2, c] - z
        height = dx * disc[4, c] + dy * disc[5, c] + dz * disc[6, c]
        side2 = dx * dx + dy * dy + dz * dz - height * height
        beyond = np.sqrt(side2 if side2 > zero else zero) - disc[3, c]
        beyond = beyond if beyond > zero else zero
        bound[c] = height * height + beyond * beyond


@_vector
def _measure(axes, triangle, corner, chosen, m, lanes, best):
    """
    Find the triangle nearest to the point in each lane.

    In the axes of a triangle its corners are (0, 0), (b, 0) and (p, q), and the distance is that in the plane, to the
    nearest edge or zero inside, and the height above it.

    ``lanes`` (4 LANES,) float32: x, y, z and room for the distances; ``best`` (LANES,) is filled.
    """
    zero, one = _f(0.0), _f(1.0)
    lanes[3 * LANES:] = np.inf
    for c in range(m):
        a = chosen[c]
        t = triangle[a]
        ux, uy, uz = axes[t, 0], axes[t, 1], axes[t, 2]
        vx, vy, vz = axes[t, 3], axes[t, 4], axes[t, 5]
        nx, ny, nz = axes[t, 6], axes[t, 7], axes[t, 8]
        b, p, q, per_ac, per_bc = axes[t, 9], axes[t, 10], axes[t, 11], axes[t, 12], axes[t, 13]
        u0, v0, n0 = corner[a, 0], corner[a, 1], corner[a, 2]
        for i in range(LANES):
            x, y, z = lanes[i], lanes[LANES + i], lanes[2 * LANES + i]
            u = ux * x + uy * y + uz * z - u0
            v = vx * x + vy * y + vz * z - v0
            h = nx * x + ny * y + nz * z - n0
            # edge ab
            s = u if u > zero else zero
            s = s if s < b else b
            d2 = (u - s) * (u - s) + v * v
            # edge ac
            s = (u * p + v * q) * per_ac
            s = s if s > zero else zero
            s = s if s < one else one
            e2 = (u - s * p) * (u - s * p) + (v - s * q) * (v - s * q)
            d2 = e2 if e2 < d2 else d2
            # edge bc
            w = u - b
            r = p - b
            s = (w * r + v * q) * per_bc
            s = s if s > zero else zero
            s = s if s < one else one
            e2 = (w - s * r) * (w - s * r) + (v - s * q) * (v - s * q)
            d2 = e2 if e2 < d2 else d2
            d2 = zero if (v > zero) & (q * u > p * v) & (q * w < r * v) else d2
            d2 += h * h
            nearer = d2 < lanes[3 * LANES + i]
            lanes[3 * LANES + i] = d2 if nearer else lanes[3 * LANES + i]
            best[i] = a if nearer else best[i]
