# SPDX-License-Identifier: Apache-2.0
"""
Sample the distance and the gradient of a gradient-SDF at one or many points.

Each of the eight nodes around a point x predicts the distance there as d_i + g_i . (x - x_i), the
first-order model of Sommer et al. (CVPR 2022). The trilinear interpolation of these predictions has
the same error as that of the distances d_i, with opposite sign. Their mean,
sum_i w_i (d_i + g_i . (x - x_i) / 2), is continuous and exact for quadratic distances.

Above a groove, the distance has a crease where two walls are equally near. The mean is up to a
third of a voxel too small there, and the gradient is that of one wall or the other. The centre of a
ball tip in a groove narrower than itself lies exactly on the crease. So for a ball tip, the
gradient on a crease has the length `UNCERTAIN` instead of one: such a point hardly pulls the pose.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from gsdf_registration.common.numba_options import inlined_kernel, kernel
from gsdf_registration.common.rigid import Array
from gsdf_registration.field.blend import blend_nodes

CELLS = 4           # fine cells along the edge of a block
# nodes along the edge: a block includes its far faces, so that no cell spans two blocks
NODES = CELLS + 1

# length of the mean gradient of the nodes of a cell: if it is shorter, the cell may have a crease
CREASE = 0.97
UNCERTAIN = 0.01    # length of the gradient on a crease; 0 would leave no direction
CANCELLED = 1e-6    # below this length the mean gradient has no direction

BATCH = 128         # points sampled at a time; their intermediate results fit into the L1 cache

_f = np.float32
_u = np.uint64      # unsigned indices avoid the check for negative ones
# for the block of a fine cell and its index there; CELLS is a power of two
SHIFT, LAST = _u(CELLS.bit_length() - 1), _u(CELLS - 1)


class FieldArrays(NamedTuple):
    """
    The arrays of a gradient-SDF for the kernels, bone frame.

    A node is (distance, gx, gy, gz). The distance is negative inside the bone, the gradient has
    unit length and points outward. There are two levels: blocks of fine nodes in a band around the
    surface, and coarse nodes at the corners of all cells of the grid.

    origin : (3,) float64, m, position of coarse node (0, 0, 0)
    voxel : float, m, spacing of the fine nodes; the spacing of the coarse nodes is CELLS * voxel
    block_of : (bx, by, bz) int32, index of the block of a coarse cell, -1 if it has none
    nodes : (m, 4) float32, the n blocks, each (NODES, NODES, NODES) in C order, then the coarse
        nodes (bx + 1, by + 1, bz + 1)
    first_coarse : int, row of the first coarse node, n * NODES**3
    offset : float, m, subtracted from every distance: the surface is that of the bone, moved
        outward by it
    """

    origin: Array
    voxel: float
    block_of: np.ndarray[Any, np.dtype[np.int32]]
    nodes: np.ndarray[Any, np.dtype[np.float32]]
    first_coarse: int
    offset: float = 0.0


@inlined_kernel
def _regular_length(field):
    """Return the length from which on the mean gradient of a cell shows that it has no crease."""
    return _f(CREASE) if field.offset > 0.0 else _f(CANCELLED)


@inlined_kernel
def _blend(nodes, at, stride_x, stride_y, u, v, w, step, regular):
    """Sample a cell of width ``step`` with first node row ``at``, at (u, v, w) in [0, 1]^3."""
    d, gx, gy, gz, x, y, z = blend_nodes(nodes, at, stride_x, stride_y, u, v, w)
    # sum_i w_i g_i . (x - x_i) / 2, with the terms of opposite faces combined
    one = _f(1.0)
    d -= _f(0.5) * step * (u * (one - u) * x + v * (one - v) * y + w * (one - w) * z)
    n = math.sqrt(gx * gx + gy * gy + gz * gz)
    if n < _f(CANCELLED):  # on the medial axis the gradients cancel: use that of one node
        return float(d), float(nodes[at, 1]), float(nodes[at, 2]), float(nodes[at, 3])
    s = one / n
    # gradients point to each other on a crease, and away from each other around a ridge
    if n < regular and x + y + z < _f(0.0):
        s *= _f(UNCERTAIN)
    return float(d), float(gx * s), float(gy * s), float(gz * s)


@inlined_kernel
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
    # one call for both levels, which is inlined once
    return _blend(field.nodes, at, stride_x, stride_y, _f(u), _f(v), _f(w), _f(step),
                  _regular_length(field))


@kernel
def _sample_outside(field, px, py, pz):
    """Sample outside the grid, by way of the surface point nearest to the border of the grid."""
    if not math.isfinite(px + py + pz):     # it has no cell: an index would be out of range
        return math.nan, math.nan, math.nan, math.nan
    edge = CELLS * field.voxel
    bx, by, bz = field.block_of.shape
    # the far face of the grid belongs to the last cell
    qx, qy = min(max(px, 0.0), bx - 1e-6), min(max(py, 0.0), by - 1e-6)
    qz = min(max(pz, 0.0), bz - 1e-6)
    i, j, k = _u(qx), _u(qy), _u(qz)
    d, gx, gy, gz = _sample_cell(field, i, j, k, qx - i, qy - j, qz - k)
    rx, ry, rz = (px - qx) * edge + d * gx, (py - qy) * edge + d * gy, (pz - qz) * edge + d * gz
    d = math.sqrt(rx * rx + ry * ry + rz * rz)
    return d, rx / d, ry / d, rz / d


@inlined_kernel
def sample(field, x, y, z):
    """Return (distance, gx, gy, gz) of the `FieldArrays` at any point (x, y, z), m."""
    per_edge = 1.0 / (CELLS * field.voxel)
    px = (x - field.origin[0]) * per_edge
    py = (y - field.origin[1]) * per_edge
    pz = (z - field.origin[2]) * per_edge
    bx, by, bz = field.block_of.shape
    if 0.0 <= px < bx and 0.0 <= py < by and 0.0 <= pz < bz:
        i, j, k = _u(px), _u(py), _u(pz)
        d, gx, gy, gz = _sample_cell(field, i, j, k, px - i, py - j, pz - k)
    else:
        d, gx, gy, gz = _sample_outside(field, px, py, pz)
    return d - field.offset, gx, gy, gz


@kernel
def sample_batch(field, x, origin, n, value):
    """
    Fill ``value`` (4, BATCH) float32, distance and gradient, at the first ``n`` points of a batch.

    This takes half as long as `sample` for each point. The steps of one sample depend on each
    other; here each step is a loop over the batch, which is vectorized or at least pipelined.

    x : (3, BATCH) float64, m, relative to ``origin`` (3,) in the bone frame
    """
    cell = np.empty((3, BATCH), np.int32)
    share = np.empty((3, BATCH), np.float32)
    for a in range(3):
        _find(x[a], origin[a] - field.origin[a], field.voxel, CELLS * field.block_of.shape[a], n,
              cell[a], share[a])
    _blend_batch(field, cell, share, n, value)
    if _normalize(value, n, _regular_length(field)) == n:
        return
    for k in range(n):      # on the medial axis, on a crease or in a cell without fine nodes
        if value[1, k] == 0.0 and value[2, k] == 0.0 and value[3, k] == 0.0:
            value[0, k], value[1, k], value[2, k], value[3, k] = sample(
                field, origin[0] + x[0, k], origin[1] + x[1, k], origin[2] + x[2, k])


@kernel
def _find(x, shift, voxel, cells, n, cell, share):
    """Fill the index of the fine cell along one axis, -1 outside the grid, and the share in it."""
    per_cell = 1.0 / voxel
    for k in range(n):
        place = (x[k] + shift) * per_cell
        inside = (place >= 0.0) & (place < cells)
        place = place if inside else -1.0
        cell[k] = np.int32(place)
        share[k] = place - np.int32(place)


@kernel
def _blend_batch(field, cell, share, n, value):
    """Fill ``value`` from the fine nodes; gradients are not normalized, zero without nodes."""
    half, one, offset = _f(0.5 * field.voxel), _f(1.0), _f(field.offset)
    for k in range(n):
        i, j, m = _u(cell[0, k]), _u(cell[1, k]), _u(cell[2, k])
        inside = min(cell[0, k], cell[1, k], cell[2, k]) >= 0
        block = field.block_of[i >> SHIFT, j >> SHIFT, m >> SHIFT] if inside else -1
        if block < 0:
            value[1, k] = value[2, k] = value[3, k] = 0.0
            continue
        at = _u(block) * _u(NODES**3) + (
            ((i & LAST) * _u(NODES) + (j & LAST)) * _u(NODES) + (m & LAST))
        u, v, w = share[0, k], share[1, k], share[2, k]
        d, value[1, k], value[2, k], value[3, k], x, y, z = blend_nodes(
            field.nodes, at, _u(NODES * NODES), _u(NODES), u, v, w)
        # the same formula as in `_blend`
        d -= half * (u * (one - u) * x + v * (one - v) * y + w * (one - w) * z)
        value[0, k] = d - offset


@kernel
def _normalize(value, n, regular):
    """Normalize the gradients, or set shorter ones to zero; return how many are not zero."""
    count = 0
    for k in range(n):
        x, y, z = value[1, k], value[2, k], value[3, k]
        length = math.sqrt(x * x + y * y + z * z)
        s = _f(1.0) / length if length >= regular else _f(0.0)
        value[1, k], value[2, k], value[3, k] = x * s, y * s, z * s
        count += 1 if length >= regular else 0
    return count


@kernel
def sample_many(field, points, distance, gradient):
    """Fill ``distance`` (n,) and ``gradient`` (n, 3) at ``points`` (n, 3)."""
    x = np.empty((3, BATCH))
    value = np.empty((4, BATCH), np.float32)
    for first in range(0, len(points), BATCH):
        n = min(BATCH, len(points) - first)
        for k in range(n):
            x[0, k], x[1, k], x[2, k] = points[first + k]
        sample_batch(field, x, np.zeros(3), n, value)
        for k in range(n):
            distance[first + k] = value[0, k]
            for a in range(3):
                gradient[first + k, a] = value[1 + a, k]
