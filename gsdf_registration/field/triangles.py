# SPDX-License-Identifier: Apache-2.0
"""
Exact signed distance and gradient to a triangle.

The closest point is found with the Voronoi regions of the triangle (Ericson, Real-Time Collision
Detection, 5.1.5). The sign is given by the pseudonormal of the closest face, edge or corner
(Baerentzen & Aanaes, TVCG 2005). ``tri`` is `Tree.triangle`.
"""

from __future__ import annotations

import math

from gsdf_registration.common.numba_options import inlined


@inlined
def closest(tri, i, x, y, z):
    """Return (v, w, row) of the closest point a + v ab + w ac, with its row of `pseudonormals`."""
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


@inlined
def offset(tri, i, v, w, x, y, z):
    """Return the vector from the point (v, w) of triangle ``i`` to (x, y, z)."""
    return (x - tri[i, 0] - v * tri[i, 3] - w * tri[i, 6],
            y - tri[i, 1] - v * tri[i, 4] - w * tri[i, 7],
            z - tri[i, 2] - v * tri[i, 5] - w * tri[i, 8])


@inlined
def distance2(tri, i, x, y, z):
    """
    Return the squared distance from (x, y, z) to triangle ``i``, for comparisons.

    It is that to the plane if the projection is inside the triangle, else that to the nearest edge.
    It is computed from two dot products without branches, accurate to 1e-16 of the squared distance
    to corner a.
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
    # squared distance to the plane and to each edge, minus |p - a|^2
    ab = _along(d1, tri[i, 12], abab)
    ac = _along(d2, tri[i, 13], acac)
    bc = _along(d2 - d1 - abac + abab, tri[i, 14], abab - 2.0 * abac + acac) + abab - 2.0 * d1
    plane = -(v * d1 + w * d2) * tri[i, 15]
    least = ab if ab < ac else ac
    least = bc if bc < least else least
    least = plane if (v >= 0.0) & (w >= 0.0) & (v + w <= det) else least
    least += px * px + py * py + pz * pz
    return least if least > 0.0 else 0.0


@inlined
def _along(dot, inverse, length2):
    """Return the minimum of t^2 length2 - 2 t dot for t in [0, 1]."""
    t = dot * inverse
    t = t if t > 0.0 else 0.0
    t = t if t < 1.0 else 1.0
    return t * (t * length2 - 2.0 * dot)


@inlined
def write_sample(tri, normal, i, x, y, z, on_surface, out, row):
    """
    Write signed distance and unit gradient at (x, y, z) to out[row], given the nearest triangle.

    Below the distance ``on_surface`` the gradient is the pseudonormal, because the direction to the
    closest point is undefined.
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
