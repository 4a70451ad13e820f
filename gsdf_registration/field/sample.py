# SPDX-License-Identifier: Apache-2.0
"""
Distance and gradient of a gradient-SDF at any point, in one call.

Each of the eight nodes round a point predicts the distance there from its own sample, d_i + g_i .
(x - x_i), the first-order model of Sommer et al. (CVPR 2022).  The trilinear blend of these
predictions errs by as much to one side as the blend of the plain d_i to the other; half way
between, sum_i w_i (d_i + g_i . (x - x_i) / 2), is exact for quadratic distances and continuous.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from gsdf_registration.rigid import Array

CELLS = 4           # fine cells along an edge of a block
# nodes along an edge: a block holds its far faces too, so that no cell spans two blocks
NODES = CELLS + 1

_f = np.float32
_u = np.uint64      # unsigned indices spare the kernels the check for negative ones

# A call passes the whole field by value, 30 words: inlining halves the time of a sample.
# Products may be fused with sums (FMA), which loses no precision; order and all else stay
# as written.
_options: dict[str, Any] = {
    'nogil': True, 'cache': True, 'error_model': 'numpy', 'fastmath': {'contract'}
}
_inline = nb.njit(forceinline=True, **_options)


class FieldArrays(NamedTuple):
    """
    A gradient-SDF as the kernels see it; lengths in metres, bone frame.

    A node is (distance, gx, gy, gz): negative inside the bone, the gradient of unit length, away
    from the bone.  There are two levels: blocks of fine nodes in a band round the surface, and
    coarse nodes at the block corners of the whole box.

    origin : (3,) float64, position of coarse node (0, 0, 0)
    voxel : float, spacing of the fine nodes; the coarse ones stand CELLS * voxel apart
    block_of : (bx, by, bz) int32, index of the fine block of a coarse cell; -1 where there is none
    nodes : (m, 4) float32: the n blocks, each (NODES, NODES, NODES) in C order, then the coarse (bx
        + 1, by + 1, bz + 1)
    first_coarse : int, row of the first coarse node, n * NODES**3
    """

    origin: Array
    voxel: float
    block_of: np.ndarray[Any, np.dtype[np.int32]]
    nodes: np.ndarray[Any, np.dtype[np.float32]]
    first_coarse: int


@_inline
def _lerp(a, b, t):
    return a + t * (b - a)


@_inline
def _face(nodes, n00, n01, n10, n11, what, s, t):
    """Blend a column of four nodes round a face of a cell."""
    return _lerp(_lerp(nodes[n00, what], nodes[n01, what], s),
                 _lerp(nodes[n10, what], nodes[n11, what], s), t)


@_inline
def _blend(nodes, at, stride_x, stride_y, u, v, w, step):
    """Blend the cell with first node row ``at``, at (u, v, w) in [0, 1]^3; ``step``: spacing."""
    n000, n001, n010, n011 = at, at + _u(1), at + stride_y, at + stride_y + _u(1)
    n100, n101, n110, n111 = n000 + stride_x, n001 + stride_x, n010 + stride_x, n011 + stride_x
    d = _lerp(_face(nodes, n000, n001, n010, n011, 0, w, v),
              _face(nodes, n100, n101, n110, n111, 0, w, v), u)
    # each gradient component on the two faces of the cell across its own axis
    x0 = _face(nodes, n000, n001, n010, n011, 1, w, v)
    x1 = _face(nodes, n100, n101, n110, n111, 1, w, v)
    y0 = _face(nodes, n000, n001, n100, n101, 2, w, u)
    y1 = _face(nodes, n010, n011, n110, n111, 2, w, u)
    z0 = _face(nodes, n000, n010, n100, n110, 3, v, u)
    z1 = _face(nodes, n001, n011, n101, n111, 3, v, u)
    # sum_i w_i g_i . (x - x_i) / 2, with the weights of opposite faces multiplied out
    one = _f(1.0)
    d += _f(0.5) * step * (u * (one - u) * (x0 - x1) + v * (one - v) * (y0 - y1)
                           + w * (one - w) * (z0 - z1))
    gx, gy, gz = _lerp(x0, x1, u), _lerp(y0, y1, v), _lerp(z0, z1, w)
    n = math.sqrt(gx * gx + gy * gy + gz * gz)
    if n < _f(1e-6):  # on the medial axis the gradients cancel: take one side's
        return float(d), float(nodes[at, 1]), float(nodes[at, 2]), float(nodes[at, 3])
    s = one / n
    return float(d), float(gx * s), float(gy * s), float(gz * s)


@_inline
def _sample_cell(field, i, j, k, u, v, w):
    """Sample at (u, v, w) in [0, 1]^3 of coarse cell (i, j, k)."""
    block = field.block_of[i, j, k]
    if block < 0:
        stride_y = _u(field.block_of.shape[2] + 1)
        stride_x = _u(field.block_of.shape[1] + 1) * stride_y
        at = _u(field.first_coarse) + i * stride_x + j * stride_y + k
        step = CELLS * field.voxel
    else:
        u, v, w = u * CELLS, v * CELLS, w * CELLS
        a, b, c = _u(u), _u(v), _u(w)
        stride_x, stride_y = _u(NODES * NODES), _u(NODES)
        at = ((_u(block) * _u(NODES) + a) * _u(NODES) + b) * _u(NODES) + c
        u, v, w, step = u - a, v - b, w - c, field.voxel
    # one blend for both levels: inlined once
    return _blend(field.nodes, at, stride_x, stride_y, _f(u), _f(v), _f(w), _f(step))


@nb.njit(**_options)
def _sample_outside(field, px, py, pz):
    """Sample outside the box: measure from the surface point nearest to where the box is left."""
    if not math.isfinite(px + py + pz):     # it has no cell: reading one would leave the array
        return math.nan, math.nan, math.nan, math.nan
    edge = CELLS * field.voxel
    bx, by, bz = field.block_of.shape
    # the last cell's far face counts as its inside
    qx, qy = min(max(px, 0.0), bx - 1e-6), min(max(py, 0.0), by - 1e-6)
    qz = min(max(pz, 0.0), bz - 1e-6)
    i, j, k = _u(qx), _u(qy), _u(qz)
    d, gx, gy, gz = _sample_cell(field, i, j, k, qx - i, qy - j, qz - k)
    rx, ry, rz = (px - qx) * edge + d * gx, (py - qy) * edge + d * gy, (pz - qz) * edge + d * gz
    d = math.sqrt(rx * rx + ry * ry + rz * rz)
    return d, rx / d, ry / d, rz / d


@_inline
def sample(field, x, y, z):
    """Return (distance, gx, gy, gz) of the `FieldArrays` at any one point in space, in metres."""
    per_edge = 1.0 / (CELLS * field.voxel)
    px = (x - field.origin[0]) * per_edge
    py = (y - field.origin[1]) * per_edge
    pz = (z - field.origin[2]) * per_edge
    bx, by, bz = field.block_of.shape
    if 0.0 <= px < bx and 0.0 <= py < by and 0.0 <= pz < bz:
        i, j, k = _u(px), _u(py), _u(pz)
        return _sample_cell(field, i, j, k, px - i, py - j, pz - k)
    return _sample_outside(field, px, py, pz)


@_inline
def sample_coarse(field, x, y, z):
    """Return (distance, gx, gy, gz) from the nearest coarse node, one fetch: for a wide search."""
    edge = CELLS * field.voxel
    bx, by, bz = field.block_of.shape
    px = (x - field.origin[0]) / edge
    py = (y - field.origin[1]) / edge
    pz = (z - field.origin[2]) / edge
    # the nearest node inside the box; beyond it its plane goes on
    i = _u(min(max(px + 0.5, 0.0), float(bx)))
    j = _u(min(max(py + 0.5, 0.0), float(by)))
    k = _u(min(max(pz + 0.5, 0.0), float(bz)))
    at = _u(field.first_coarse) + (i * _u(by + 1) + j) * _u(bz + 1) + k
    gx, gy, gz = field.nodes[at, 1], field.nodes[at, 2], field.nodes[at, 3]
    return field.nodes[at, 0] + edge * (gx * (px - i) + gy * (py - j) + gz * (pz - k)), gx, gy, gz


@nb.njit(**_options)
def sample_many(field, points, distance, gradient):
    """Fill ``distance`` (n,) and ``gradient`` (n, 3) at ``points`` (n, 3)."""
    for i in range(len(points)):
        d, gx, gy, gz = sample(field, points[i, 0], points[i, 1], points[i, 2])
        distance[i] = d
        gradient[i, 0] = gx
        gradient[i, 1] = gy
        gradient[i, 2] = gz
