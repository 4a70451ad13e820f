# SPDX-License-Identifier: Apache-2.0
"""
Triangles made ready for distance queries, and the exact distance to one of them.

The closest point on a triangle is found by its Voronoi regions (Ericson, Real-Time Collision Detection,
5.1.5); the sign comes from the angle-weighted pseudonormal of the face, edge or vertex it lies on
(Baerentzen & Aanaes, TVCG 2005).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration.field.pseudonormals import pseudonormals
from gsdf_registration.rigid import Array

LEAF = 16    # triangles in a leaf of the tree, at most

_compiled = nb.njit(nogil=True, cache=True, error_model='numpy')
_inline = nb.njit(nogil=True, cache=True, error_model='numpy', forceinline=True)


class Tree(NamedTuple):
    """
    Triangles in the order of the leaves of a complete binary tree.

    Node i has the children 2i and 2i + 1, the root is 1.

    box : (2 l, 6) float64, low and high corner of what a node holds; leaves are the nodes l .. 2l - 1
    start : (l + 1,) int64, leaf j holds the triangles start[j] .. start[j + 1] - 1
    triangle : (m, 16) float64, corner a, edges ab and ac, ab.ab, ab.ac, ac.ac, and the inverses of ab.ab,
        ac.ac, bc.bc and of the square of twice the area
    disc : (m, 4) float64, centre and radius of the smallest circle round the triangle
    axes : (m, 14) float32, unit vectors along ab, across it in the plane, and normal to it; in these axes,
        from a, b = (b, 0) and c = (p, q): b, p, q, and the inverses of ac.ac and bc.bc
    normal : (m, 7, 3) float32, pseudonormals of the face, edges ab, bc, ca and corners a, b, c
    """

    box: Array
    start: np.ndarray
    triangle: Array
    disc: Array
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
    # the order of a kd-tree: halves of it, halves of these and so on are neighbours in space
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
    triangle, disc, axes = np.empty((len(faces), 16)), np.empty((len(faces), 4)), np.empty((len(faces), 14), np.float32)
    _prepare(corners, triangle, disc, axes)
    return Tree(box, start, triangle, disc, axes, pseudonormals(vertices, faces)[order])


@_compiled
def _prepare(corners, triangle, disc, axes):
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
        # the circumcentre; beyond a side, the triangle is obtuse and the middle of that side will do
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
        disc[t, 3] = math.sqrt(r2) * (1.0 + 1e-5)
        # u along ab, the normal, v across
        b, double = math.sqrt(abab), math.sqrt(area2)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            disc[t, i] = corners[t, 0, i] + v * ab[i] + w * ac[i]
            axes[t, i] = ab[i] / b
            axes[t, 3 + i] = (ac[i] - ab[i] * (abac / abab)) * (b / double)
            axes[t, 6 + i] = (ab[j] * ac[k] - ab[k] * ac[j]) / double
        axes[t, 9], axes[t, 10], axes[t, 11] = b, abac / b, double / b
        axes[t, 12], axes[t, 13] = 1.0 / acac, 1.0 / bcbc


@_inline
def closest(tri, i, x, y, z):
    """Return (v, w, feature): the closest point a + v ab + w ac of triangle ``i``; 0..6 in `pseudonormals`."""
    px = x - tri[i, 0]
    py = y - tri[i, 1]
    pz = z - tri[i, 2]
    d1 = tri[i, 3] * px + tri[i, 4] * py + tri[i, 5] * pz
    d2 = tri[i, 6] * px + tri[i, 7] * py + tri[i, 8] * pz
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0, 4
    d3 = d1 - tri[i, 9]
    d4 = d2 - tri[i, 10]
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0, 5
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0, 1
    d5 = d1 - tri[i, 10]
    d6 = d2 - tri[i, 11]
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0, 6
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6), 3
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w, 2
    s = 1.0 / (va + vb + vc)
    return vb * s, vc * s, 0


@_inline
def offset(tri, i, v, w, x, y, z):
    """Return the vector from the point (v, w) of triangle ``i`` to (x, y, z)."""
    return (x - tri[i, 0] - v * tri[i, 3] - w * tri[i, 6],
            y - tri[i, 1] - v * tri[i, 4] - w * tri[i, 7],
            z - tri[i, 2] - v * tri[i, 5] - w * tri[i, 8])


@_inline
def distance2(tri, i, x, y, z):
    """
    Return the squared distance from (x, y, z) to triangle ``i``, to choose by.

    To the plane if the foot lies inside, else to the nearest edge: all from two dot products, without a branch
    to mispredict; good to 1e-16 of the squared distance to corner a.
    """
    px = x - tri[i, 0]
    py = y - tri[i, 1]
    pz = z - tri[i, 2]
    d1 = tri[i, 3] * px + tri[i, 4] * py + tri[i, 5] * pz
    d2 = tri[i, 6] * px + tri[i, 7] * py + tri[i, 8] * pz
    abab, abac, acac = tri[i, 9], tri[i, 10], tri[i, 11]
    v = acac * d1 - abac * d2
    w = abab * d2 - abac * d1
    det = abab * acac - abac * abac
    # squared distance to a, less |p - a|^2, of the nearest point of the plane and of each edge
    ab = _along(d1, tri[i, 12], abab)
    ac = _along(d2, tri[i, 13], acac)
    bc = _along(d2 - d1 - abac + abab, tri[i, 14], abab - 2.0 * abac + acac) + abab - 2.0 * d1
    plane = -(v * d1 + w * d2) * tri[i, 15]
    least = ab if ab < ac else ac
    least = bc if bc < least else least
    least = plane if (v >= 0.0) & (w >= 0.0) & (v + w <= det) else least
    least += px * px + py * py + pz * pz
    return least if least > 0.0 else 0.0


@_inline
def _along(dot, inverse, length2):
    """Return the least of t^2 length2 - 2 t dot for t in [0, 1]."""
    t = dot * inverse
    t = t if t > 0.0 else 0.0
    t = t if t < 1.0 else 1.0
    return t * (t * length2 - 2.0 * dot)


@_inline
def write_sample(tri, normal, i, x, y, z, on_surface, out, row):
    """
    Write signed distance and unit gradient at (x, y, z), whose nearest triangle is ``i``, to ``out[row]``.

    ``on_surface``: distance below which the direction to the surface is lost; the pseudonormal it is then.
    """
    v, w, feature = closest(tri, i, x, y, z)
    dx, dy, dz = offset(tri, i, v, w, x, y, z)
    nx, ny, nz = normal[i, feature, 0], normal[i, feature, 1], normal[i, feature, 2]
    d = math.sqrt(dx * dx + dy * dy + dz * dz)
    if d > on_surface:
        d = math.copysign(d, dx * nx + dy * ny + dz * nz)
        s = 1.0 / d
        nx, ny, nz = dx * s, dy * s, dz * s
    out[row, 0] = d
    out[row, 1] = nx
    out[row, 2] = ny
    out[row, 3] = nz
