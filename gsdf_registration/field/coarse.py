# SPDX-License-Identifier: Apache-2.0
"""Find the coarse cells near the surface and compute the samples at the coarse nodes."""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import compiled, inlined
from gsdf_registration.field.triangles import distance2, write_sample


@compiled
def cell_distances(tree, origin, edge, reach, first, last, distance):
    """
    Compute the distance from the centres of cells to the surface, up to ``reach``.

    Only layers from ``first`` to before ``last`` of ``distance`` (bx, by, bz) are written, and only
    where the distance is smaller than the present value.
    """
    triangle, ball = tree.triangle, tree.ball
    _, by, bz = distance.shape
    for t in range(len(triangle)):
        grown = ball[t, 3] + reach
        i0, i1 = _centres_between(ball[t, 0] - origin[0], grown, edge, first, last)
        if i0 >= i1:
            continue
        j0, j1 = _centres_between(ball[t, 1] - origin[1], grown, edge, 0, by)
        k0, k1 = _centres_between(ball[t, 2] - origin[2], grown, edge, 0, bz)
        for i in range(i0, i1):
            x = origin[0] + (i + 0.5) * edge
            for j in range(j0, j1):
                y = origin[1] + (j + 0.5) * edge
                for k in range(k0, k1):
                    z = origin[2] + (k + 0.5) * edge
                    limit = ball[t, 3] + min(reach, distance[i, j, k])
                    if ((x - ball[t, 0]) ** 2 + (y - ball[t, 1]) ** 2
                            + (z - ball[t, 2]) ** 2 > limit * limit):
                        continue
                    d = math.sqrt(distance2(triangle, t, x, y, z))
                    if d < distance[i, j, k] and d <= reach:
                        distance[i, j, k] = d


@inlined
def _centres_between(x, radius, edge, first, last):
    """Return the range of cells along one axis with centres within ``radius`` of ``x``."""
    return (max(first, math.ceil((x - radius) / edge - 0.5)),
            min(last, math.floor((x + radius) / edge + 0.5)))


@compiled
def propagate_nearest(tree, origin, edge, axis, first, last, nearest, distance2s):
    """
    Propagate the nearest triangles of the known nodes along ``axis`` in both directions.

    Lines are independent of each other; only those from ``first`` to before ``last`` along the next
    axis are processed. ``nearest`` (nx, ny, nz) int32 is -1 where unknown, ``distance2s`` float64
    is inf there. Both are complete after one pass along each axis.
    """
    triangle = tree.triangle
    at = np.empty(3, np.int64)
    n = nearest.shape[axis]
    for p in range(first, last):
        for q in range(nearest.shape[(axis + 2) % 3]):
            at[(axis + 1) % 3], at[(axis + 2) % 3] = p, q
            for way in range(2):
                t = -1
                for s in range(n):
                    at[axis] = s if way == 0 else n - 1 - s
                    i, j, k = at[0], at[1], at[2]
                    if t >= 0 and t != nearest[i, j, k]:
                        d2 = distance2(triangle, t, origin[0] + i * edge, origin[1] + j * edge,
                                       origin[2] + k * edge)
                        if d2 < distance2s[i, j, k]:
                            distance2s[i, j, k] = d2
                            nearest[i, j, k] = t
                    t = nearest[i, j, k]


@compiled
def fill_coarse(tree, origin, edge, nearest, first, last, coarse):
    """Fill layers of ``coarse`` (nx ny nz, 4) float32 given the triangles ``nearest``."""
    triangle, normal = tree.triangle, tree.normal
    _, ny, nz = nearest.shape
    for i in range(first, last):
        for j in range(ny):
            for k in range(nz):
                write_sample(triangle, normal, nearest[i, j, k], origin[0] + i * edge,
                             origin[1] + j * edge, origin[2] + k * edge, 1e-6 * edge, coarse,
                             (i * ny + j) * nz + k)
