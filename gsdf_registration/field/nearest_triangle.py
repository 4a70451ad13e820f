# SPDX-License-Identifier: Apache-2.0
"""
Find the triangle nearest to each node.

`gather` finds the candidate triangles of a block, `narrow` those of a group of its nodes by their
bounding spheres, and `measure` the nearest one in single precision, with one node per SIMD lane.
Single precision is accurate to a nanometre within a few millimetres.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.numba_options import compiled, vectorized
from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.field.triangles import closest, offset

LANES = 16      # maximum number of nodes in a group

_f = np.float32


def _groups() -> np.ndarray:
    """
    Return the index ranges of the groups of nodes in a block: first i, j, k, one past the last.

    The first groups are the quarters of the block, the others are the nodes on its far sides.
    """
    quarters = [(0, j, k, CELLS, j + 2, k + 2) for j in range(0, CELLS, 2)
                for k in range(0, CELLS, 2)]
    sides = [(CELLS * i, CELLS * j, CELLS * k, CELLS + i, CELLS + j, CELLS + k)
             for i, j, k in np.ndindex(2, 2, 2) if i or j or k]
    return np.array(quarters + sides)


GROUPS = _groups()


@compiled
def gather(tree, centre, radius, candidate, ball, corner):
    """
    Find all triangles that may be within ``radius`` of ``centre`` and return their number.

    The triangle nearest to any point of a sphere of radius R is within dmin + 2 R of its centre,
    where dmin is the distance from the centre to the surface.

    The outputs are ``candidate`` (capacity,) int32, the triangles, ``ball`` (4, capacity) float32,
    centre and radius of their bounding spheres, and ``corner`` (capacity, 3) float32, corner a in
    the axes of the triangle. All positions are relative to ``centre``.
    """
    box, start, triangle = tree.box, tree.start, tree.triangle
    tree_ball, axes = tree.ball, tree.axes
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
            x = tree_ball[t, 0] - centre[0]
            y = tree_ball[t, 1] - centre[1]
            z = tree_ball[t, 2] - centre[2]
            if x * x + y * y + z * z <= (radius + tree_ball[t, 3]) ** 2:
                candidate[n] = t
                ball[0, n], ball[1, n], ball[2, n], ball[3, n] = x, y, z, tree_ball[t, 3]
                x = triangle[t, 0] - centre[0]
                y = triangle[t, 1] - centre[1]
                z = triangle[t, 2] - centre[2]
                for a in range(3):
                    corner[n,
                           a] = axes[t, 3 * a] * x + axes[t, 3 * a + 1] * y + axes[t, 3 * a + 2] * z
                n += 1
    return n


@compiled
def narrow(triangle, candidate, ball, n, centre, voxel, g, bound, chosen):
    """
    Select the candidates that may be nearest to a node of group ``g`` and return their number.

    Let q be a point of the surface near the group. A triangle in a bounding sphere (m, r) is
    farther from x than q if |x - m| - r > |x - q|, that is, if
    |x - m|^2 - |x - q|^2 > 2 r |x - q| + r^2. The left side is linear in x, so its minimum is at a
    corner of the group.
    """
    half = np.empty(3, np.float32)
    middle = np.empty(3, np.float32)
    for a in range(3):
        half[a] = 0.5 * (GROUPS[g, 3 + a] - GROUPS[g, a] - 1) * voxel
        middle[a] = 0.5 * (GROUPS[g, 3 + a] + GROUPS[g, a] - NODES) * voxel
    _distances2(ball, n, middle[0], middle[1], middle[2], bound)
    least = 0
    for c in range(n):
        if bound[c] < bound[least]:
            least = c
    t = candidate[least]
    x, y, z = centre[0] + middle[0], centre[1] + middle[1], centre[2] + middle[2]
    v, w, _ = closest(triangle, t, x, y, z)
    x, y, z = offset(triangle, t, v, w, x, y, z)
    _margins(ball, n, middle[0], middle[1], middle[2], _f(-x), _f(-y), _f(-z), half[0], half[1],
             half[2], bound)
    m = 0
    for c in range(n):      # written always, counted if selected: avoids a branch
        chosen[m] = c
        m += bound[c] <= 0.0
    return m


@vectorized
def _distances2(ball, n, x, y, z, bound):
    """Fill ``bound`` (n,) with the squared distances from (x, y, z) to the centres of ``ball``."""
    for c in range(n):
        bound[c] = (ball[0, c] - x) ** 2 + (ball[1, c] - y) ** 2 + (ball[2, c] - z) ** 2


@vectorized
def _margins(ball, n, x, y, z, qx, qy, qz, hx, hy, hz, bound):
    """
    Fill ``bound`` (n,) with a value that is positive if a ball can be excluded, see `narrow`.

    The group is a box with centre (x, y, z) and half widths ``h``; ``q`` is relative to the centre.
    """
    two = _f(2.0)
    q2 = qx * qx + qy * qy + qz * qz
    farthest = np.sqrt(q2) + np.sqrt(hx * hx + hy * hy + hz * hz)
    for c in range(n):
        mx = ball[0, c] - x
        my = ball[1, c] - y
        mz = ball[2, c] - z
        m2 = mx * mx + my * my + mz * mz
        r = ball[3, c]
        nearer = two * (abs(mx - qx) * hx + abs(my - qy) * hy + abs(mz - qz) * hz)
        bound[c] = m2 * _f(1.0 - 1e-5) - q2 - nearer - r * (two * farthest + r)


@vectorized
def measure(axes, candidate, corner, chosen, m, lanes, best):
    """
    Find the triangle nearest to the point in each lane.

    In the axes of a triangle, its corners are (0, 0), (b, 0) and (p, q). The squared distance is
    the sum of the squared height above the plane and the squared distance in the plane, which is
    that to the nearest edge, or zero inside.

    ``lanes`` (4 LANES,) float32 contains x, y, z and space for the squared distances; ``best``
    (LANES,) is the output.
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
