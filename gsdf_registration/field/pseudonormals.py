# SPDX-License-Identifier: Apache-2.0
"""Pseudonormals, which give the sign of the distance (Baerentzen & Aanaes, TVCG 2005)."""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import compiled, inlined
from gsdf_registration.common.rigid import Array


def pseudonormals(vertices: Array, faces: np.ndarray) -> np.ndarray:
    """
    Return the pseudonormals of each face, of its edges ab, bc, ca and of its corners a, b, c.

    The pseudonormal of an edge is the sum of the normals of the faces that share it. That of a
    corner is the sum of the normals of its faces, weighted by their angles at the corner.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32, no face of zero area

    Returns
    -------
    (m, 7, 3) float32, unit length; zero where the normals cancel

    """
    table = np.empty((len(faces), 7, 3), dtype=np.float32)
    _fill(vertices, faces, table)
    return table


@compiled
def _fill(vertices, faces, table):
    """Fill ``table``, see `pseudonormals`."""
    normal = np.empty((len(faces), 3))
    of_vertex = np.zeros((len(vertices), 3))
    for f in range(len(faces)):
        _add_corners(vertices, faces, f, normal, of_vertex)
    around, start = _faces_around_vertices(faces, len(vertices))
    for f in range(len(faces)):
        _write_unit(normal[f, 0], normal[f, 1], normal[f, 2], table, f, 0)
        for c in range(3):
            here, there = faces[f, c], faces[f, (c + 1) % 3]
            x = y = z = 0.0
            for s in range(start[here], start[here + 1]):
                g = around[s]
                if faces[g, 0] == there or faces[g, 1] == there or faces[g, 2] == there:
                    x += normal[g, 0]
                    y += normal[g, 1]
                    z += normal[g, 2]
            _write_unit(x, y, z, table, f, 1 + c)
            _write_unit(of_vertex[here, 0], of_vertex[here, 1], of_vertex[here, 2], table, f, 4 + c)


@inlined
def _add_corners(vertices, faces, f, normal, of_vertex):
    """Set the normal of face ``f`` and add it to its vertices, weighted by the angles there."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    ux, uy, uz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
    vx, vy, vz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area2 = math.sqrt(nx * nx + ny * ny + nz * nz)
    normal[f, 0], normal[f, 1], normal[f, 2] = nx / area2, ny / area2, nz / area2
    uu, uv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz
    at_a, at_b = math.atan2(area2, uv), math.atan2(area2, uu - uv)
    for i in range(3):
        of_vertex[a, i] += at_a * normal[f, i]
        of_vertex[b, i] += at_b * normal[f, i]
        of_vertex[c, i] += (math.pi - at_a - at_b) * normal[f, i]


@inlined
def _write_unit(x, y, z, table, face, row):
    """Write (x, y, z), normalized."""
    n = math.sqrt(x * x + y * y + z * z)
    s = 1.0 / n if n > 1e-9 else 0.0
    table[face, row, 0] = x * s
    table[face, row, 1] = y * s
    table[face, row, 2] = z * s


@compiled
def _faces_around_vertices(faces, n):
    """Return ``around`` and ``start``; ``around[start[v]:start[v + 1]]`` are the faces at v."""
    start = np.zeros(n + 1, np.int64)
    for f in range(len(faces)):
        for c in range(3):
            start[faces[f, c] + 1] += 1
    start = np.cumsum(start)
    free = start[:-1].copy()
    around = np.empty(3 * len(faces), np.int64)
    for f in range(len(faces)):
        for c in range(3):
            v = faces[f, c]
            around[free[v]] = f
            free[v] += 1
    return around, start
