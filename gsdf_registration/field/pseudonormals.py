# SPDX-License-Identifier: Apache-2.0
"""Normals that tell inside from outside at faces, edges and corners (Baerentzen & Aanaes, TVCG 2005)."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from gsdf_registration.rigid import Array


def pseudonormals(vertices: Array, faces: np.ndarray) -> np.ndarray:
    """
    Return the pseudonormals of every face: of itself, its edges ab, bc, ca and its corners a, b, c.

    An edge's is the sum of the normals of all faces that share it, a corner's that of its faces weighted
    by their angle there.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int, no face of zero area

    Returns
    -------
    (m, 7, 3) float32, unit length; zero where the normals cancel

    """
    table = np.zeros((len(faces), 7, 3), dtype=np.float32)
    _fill(vertices, faces, table)
    return table


@nb.njit(nogil=True, cache=True)
def _fill(vertices, faces, table):
    normal, angle = _normals_and_angles(vertices, faces)
    around, start = _faces_round_vertices(faces, len(vertices))
    total = np.zeros((7, 3))
    for f in range(len(faces)):
        total[0] = normal[f]
        total[1:] = 0.0
        for c in range(3):
            here, there = faces[f, c], faces[f, (c + 1) % 3]
            for s in range(start[here], start[here + 1]):
                g = around[s]
                for e in range(3):
                    weight = angle[g, e] if faces[g, e] == here else 1.0 if faces[g, e] == there else 0.0
                    if weight > 0.0:
                        row = 4 + c if faces[g, e] == here else 1 + c
                        for a in range(3):
                            total[row, a] += weight * normal[g, a]
        for row in range(7):
            length = math.sqrt(total[row, 0] ** 2 + total[row, 1] ** 2 + total[row, 2] ** 2)
            if length > 1e-9:
                for a in range(3):
                    table[f, row, a] = total[row, a] / length


@nb.njit(nogil=True, cache=True)
def _normals_and_angles(vertices, faces):
    """Return unit normals (m, 3) and the angles at the corners (m, 3)."""
    normal = np.empty((len(faces), 3))
    angle = np.empty((len(faces), 3))
    edge = np.empty((3, 3))
    for f in range(len(faces)):
        for c in range(3):
            for a in range(3):
                edge[c, a] = vertices[faces[f, (c + 1) % 3], a] - vertices[faces[f, c], a]
        n = np.cross(edge[0], edge[1])
        area2 = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
        for c in range(3):
            normal[f, c] = n[c] / area2
            angle[f, c] = math.atan2(area2, -np.dot(edge[c], edge[c - 1]))
    return normal, angle


@nb.njit(nogil=True, cache=True)
def _faces_round_vertices(faces, n):
    """Return ``around`` and ``start``: the faces round vertex v are ``around[start[v]:start[v + 1]]``."""
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
