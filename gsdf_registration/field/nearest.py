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

import numba as nb
import numpy as np

from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.field.triangles import distance2, write_sample

LANES = 16      # nodes of a group, at most

_f = np.float32
_compiled = nb.njit(nogil=True, cache=True, error_model='numpy')
_vector = nb.njit(nogil=True, cache=True, error_model='numpy', fastmath=True)


def _groups() -> np.ndarray:
    """Return rows (first i, j, k, one past the last i, j, k): a quarter of a block's nodes, or what is on a far side."""
    quarters = [(0, j, k, CELLS, j + 2, k + 2) for j in range(0, CELLS, 2) for k in range(0, CELLS, 2)]
    sides = [(CELLS * i, CELLS * j, CELLS * k, CELLS + i, CELLS + j, CELLS + k)
             for i, j, k in np.ndindex(2, 2, 2) if i or j or k]
    return np.array(quarters + sides)


GROUPS = _groups()


@_compiled
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
    # what passes into the inner loops are plain arrays: those of a tuple are counted in and out every time
    triangle, axes, normal = tree.triangle, tree.axes, tree.normal
    room = len(triangle)
    candidate = np.empty(room, np.int32)
    disc = np.empty((7, room), np.float32)
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
        n = _gather(tree, centre, reach, candidate, disc, corner)
        for g in range(len(GROUPS)):
            if (GROUPS[g, 3:].max() > CELLS
                    and block_of[cells[b, 0] + GROUPS[g, 0] // CELLS, cells[b, 1] + GROUPS[g, 1] // CELLS,
                                 cells[b, 2] + GROUPS[g, 2] // CELLS] >= 0):
                continue
            m = _narrow(triangle, candidate, disc, n, centre, voxel, g, bound, chosen)
            _place(voxel, g, lanes)
            _measure(axes, candidate, corner, chosen, m, lanes, best)
            _write(triangle, normal, candidate, best, centre, voxel, g, b, nodes, nearest)


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
def _gather(tree, centre, radius, candidate, disc, corner):
    """
    Find all triangles that may lie within ``radius`` of ``centre`` and return their number; positions are from there.

    ``candidate`` (room,) int32, the triangles; ``disc`` (7, room) float32, centre, radius and normal of their bounding discs;
    ``corner`` (room, 3) float32, corner a in the axes of the triangle.
    """
    box, start, triangle, tree_disc, axes = tree.box, tree.start, tree.triangle, tree.disc, tree.axes
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
            x = tree_disc[t, 0] - centre[0]
            y = tree_disc[t, 1] - centre[1]
            z = tree_disc[t, 2] - centre[2]
            if x * x + y * y + z * z <= (radius + tree_disc[t, 3]) ** 2:
                candidate[n] = t
                disc[0, n], disc[1, n], disc[2, n], disc[3, n] = x, y, z, tree_disc[t, 3]
                x = triangle[t, 0] - centre[0]
                y = triangle[t, 1] - centre[1]
                z = triangle[t, 2] - centre[2]
                for a in range(3):
                    disc[4 + a, n] = axes[t, 6 + a]
                    corner[n, a] = axes[t, 3 * a] * x + axes[t, 3 * a + 1] * y + axes[t, 3 * a + 2] * z
                n += 1
    return n


@_compiled
def _narrow(triangle, candidate, disc, n, centre, voxel, g, bound, chosen):
    """Choose the candidates that may be nearest to a node of group ``g`` and return their number."""
    x = 0.5 * (GROUPS[g, 0] + GROUPS[g, 3] - NODES) * voxel
    y = 0.5 * (GROUPS[g, 1] + GROUPS[g, 4] - NODES) * voxel
    z = 0.5 * (GROUPS[g, 2] + GROUPS[g, 5] - NODES) * voxel
    diagonal = voxel * math.sqrt((GROUPS[g, 3] - GROUPS[g, 0] - 1) ** 2 + (GROUPS[g, 4] - GROUPS[g, 1] - 1) ** 2
                                 + (GROUPS[g, 5] - GROUPS[g, 2] - 1) ** 2)
    _disc_bounds(disc, n, _f(x), _f(y), _f(z), bound)
    least = 0
    for c in range(n):
        if bound[c] < bound[least]:
            least = c
    dmin = math.sqrt(distance2(triangle, candidate[least], centre[0] + x, centre[1] + y, centre[2] + z))
    limit = _f((dmin + diagonal) ** 2 * (1.0 + 1e-5))
    m = 0
    for c in range(n):      # written every time, counted if it fits: no branch to mispredict
        chosen[m] = c
        m += bound[c] <= limit
    return m


@_compiled
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


@_compiled
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
def _measure(axes, candidate, corner, chosen, m, lanes, best):
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
        t = candidate[a]
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
