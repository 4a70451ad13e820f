# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy of triangles for distance queries."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.rigid import Array
from gsdf_registration.field.pseudonormals import pseudonormals

LEAF = 16    # maximum number of triangles in a leaf


class Tree(NamedTuple):
    """
    Triangles in the order of the leaves of a complete binary tree.

    Node i has the children 2i and 2i + 1, the root is 1.

    box : (2 l, 6) float64, lower and upper corner of each node; the leaves are nodes l .. 2l - 1
    start : (l + 1,) int64, leaf j contains the triangles start[j] .. start[j + 1] - 1
    triangle : (m, 16) float64, corner a, edges ab and ac, ab.ab, ab.ac, ac.ac, and the inverses of
        ab.ab, ac.ac, bc.bc and of the square of twice the area
    ball : (m, 4) float64, centre and radius of the smallest sphere around the triangle
    axes : (m, 14) float32, unit vectors along ab, perpendicular to ab in the plane, and normal to
        the plane; then b, p, q, where (b, 0) and (p, q) are corners b and c in these axes from a;
        then the inverses of ac.ac and bc.bc
    normal : (m, 7, 3) float32, pseudonormals of the face, edges ab, bc, ca and corners a, b, c
    """

    box: Array
    start: np.ndarray
    triangle: Array
    ball: Array
    axes: np.ndarray
    normal: np.ndarray


def build_tree(vertices: Array, faces: np.ndarray) -> Tree:
    """
    Return the search tree of a mesh.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int, m >= 1, no face of zero area

    """
    # in the order of a k-d tree, triangles of the same half, quarter, ... are close in space
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    order = cKDTree(a + b + c, leafsize=LEAF).indices
    corners = vertices[faces[order]]
    a, b, c = (corners[:, i] for i in range(3))
    leaves = 1 << max(0, math.ceil(math.log2(len(faces) / LEAF)))
    start = np.arange(leaves + 1) * len(faces) // leaves
    box = np.empty((2 * leaves, 6))
    box[leaves:, :3] = np.minimum.reduceat(np.minimum(np.minimum(a, b), c), start[:-1])
    box[leaves:, 3:] = np.maximum.reduceat(np.maximum(np.maximum(a, b), c), start[:-1])
    while leaves > 1:
        children = box[leaves:2 * leaves].reshape(-1, 2, 6)
        leaves //= 2
        box[leaves:2 * leaves, :3] = children[:, :, :3].min(axis=1)
        box[leaves:2 * leaves, 3:] = children[:, :, 3:].max(axis=1)
    m = len(faces)
    triangle, ball, axes = np.empty((m, 16)), np.empty((m, 4)), np.empty((m, 14), dtype=np.float32)
    _prepare(corners, triangle, ball, axes)
    return Tree(box, start, triangle, ball, axes, pseudonormals(vertices, faces)[order])


@compiled
def _prepare(corners, triangle, ball, axes):
    """Fill the tables of a `Tree` from the corners (m, 3, 3)."""
    ab = np.empty(3)
    ac = np.empty(3)
    for t in range(len(corners)):
        abab = abac = acac = 0.0
        for i in range(3):
            ab[i] = corners[t, 1, i] - corners[t, 0, i]
            ac[i] = corners[t, 2, i] - corners[t, 0, i]
            triangle[t, i] = corners[t, 0, i]
            triangle[t, 3 + i] = ab[i]
            triangle[t, 6 + i] = ac[i]
            abab += ab[i] * ab[i]
            abac += ab[i] * ac[i]
            acac += ac[i] * ac[i]
        bcbc = abab - 2.0 * abac + acac
        area2 = abab * acac - abac * abac
        triangle[t, 9], triangle[t, 10], triangle[t, 11] = abab, abac, acac
        triangle[t, 12], triangle[t, 13] = 1.0 / abab, 1.0 / acac
        triangle[t, 14], triangle[t, 15] = 1.0 / bcbc, 1.0 / area2
        # the circumcentre, or the midpoint of the longest side of an obtuse triangle
        v = 0.5 * acac * (abab - abac) / area2
        w = 0.5 * abab * (acac - abac) / area2
        if v <= 0.0:
            v, w = 0.0, 0.5
        elif w <= 0.0:
            v, w = 0.5, 0.0
        elif v + w >= 1.0:
            v, w = 0.5, 0.5
        r2 = max(v * v * abab + 2.0 * v * w * abac + w * w * acac,
                 (v - 1.0) ** 2 * abab + 2.0 * (v - 1.0) * w * abac + w * w * acac,
                 v * v * abab + 2.0 * v * (w - 1.0) * abac + (w - 1.0) ** 2 * acac)
        ball[t, 3] = math.sqrt(r2) * (1.0 + 1e-5)
        # u along ab, v perpendicular to it, and the normal
        b, double = math.sqrt(abab), math.sqrt(area2)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            ball[t, i] = corners[t, 0, i] + v * ab[i] + w * ac[i]
            axes[t, i] = ab[i] / b
            axes[t, 3 + i] = (ac[i] - ab[i] * (abac / abab)) * (b / double)
            axes[t, 6 + i] = (ab[j] * ac[k] - ab[k] * ac[j]) / double
        axes[t, 9], axes[t, 10], axes[t, 11] = b, abac / b, double / b
        axes[t, 12], axes[t, 13] = 1.0 / acac, 1.0 / bcbc
