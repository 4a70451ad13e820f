# SPDX-License-Identifier: Apache-2.0
"""The coarse grid: which cells are near the surface, and what lies far from it."""

from __future__ import annotations

import math

import numba as nb

from gsdf_registration.field.triangles import distance2, write_sample


@nb.njit(nogil=True, cache=True)
def mark_cells(tree, origin, edge, reach, distance, seed):
    """
    Find the cells whose centre is within ``reach`` of a triangle.

    ``distance`` (bx, by, bz) float64, as large as it may become in the beginning, is lowered to that of the centre; ``seed`` is set
    to the triangle.
    """
    bx, by, bz = distance.shape
    for t in range(len(tree.triangle)):
        x, y, z, r = tree.disc[t]
        x -= origin[0]
        y -= origin[1]
        z -= origin[2]
        grown = r + reach
        for i in range(max(0, math.ceil((x - grown) / edge - 0.5)), min(bx, math.floor((x + grown) / edge + 0.5))):
            dx = (i + 0.5) * edge
            for j in range(max(0, math.ceil((y - grown) / edge - 0.5)), min(by, math.floor((y + grown) / edge + 0.5))):
                dy = (j + 0.5) * edge
                for k in range(max(0, math.ceil((z - grown) / edge - 0.5)), min(bz, math.floor((z + grown) / edge + 0.5))):
                    dz = (k + 0.5) * edge
                    limit = r + min(reach, distance[i, j, k])
                    if (dx - x) ** 2 + (dy - y) ** 2 + (dz - z) ** 2 < limit * limit:
                        d = math.sqrt(distance2(tree.triangle, t, origin[0] + dx, origin[1] + dy, origin[2] + dz))
                        if d < distance[i, j, k] and d <= reach:
                            distance[i, j, k] = d
                            seed[i, j, k] = t


@nb.njit(nogil=True, cache=True, forceinline=True)
def _offer(tree, t, i, j, k, origin, edge, nearest, distance2s):
    """Take triangle ``t`` for node (i, j, k) if it is nearer than the one known."""
    if t >= 0 and t != nearest[i, j, k]:
        d2 = distance2(tree.triangle, t, origin[0] + i * edge, origin[1] + j * edge, origin[2] + k * edge)
        if d2 < distance2s[i, j, k]:
            distance2s[i, j, k] = d2
            nearest[i, j, k] = t


@nb.njit(nogil=True, cache=True)
def spread(tree, origin, edge, nearest, distance2s):
    """
    Spread the nearest triangles from the known nodes to all, by eight sweeps (a vector distance transform).

    ``nearest`` (nx, ny, nz) int32, -1 where unknown, and ``distance2s``, inf there, are filled.
    """
    nx, ny, nz = nearest.shape
    for direction in range(8):
        si = 1 - 2 * (direction >> 2)
        sj = 1 - 2 * (direction >> 1 & 1)
        sk = 1 - 2 * (direction & 1)
        for a in range(nx):
            i = a if si > 0 else nx - 1 - a
            for b in range(ny):
                j = b if sj > 0 else ny - 1 - b
                for c in range(nz):
                    k = c if sk > 0 else nz - 1 - c
                    if a > 0:
                        _offer(tree, nearest[i - si, j, k], i, j, k, origin, edge, nearest, distance2s)
                    if b > 0:
                        _offer(tree, nearest[i, j - sj, k], i, j, k, origin, edge, nearest, distance2s)
                    if c > 0:
                        _offer(tree, nearest[i, j, k - sk], i, j, k, origin, edge, nearest, distance2s)


@nb.njit(nogil=True, cache=True)
def fill_coarse(tree, origin, edge, nearest, coarse):
    """Fill ``coarse`` (nx ny nz, 4) float32 from the triangles in ``nearest``."""
    nx, ny, nz = nearest.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                write_sample(tree, nearest[i, j, k], origin[0] + i * edge, origin[1] + j * edge,
                             origin[2] + k * edge, 1e-6 * edge, coarse, (i * ny + j) * nz + k)
