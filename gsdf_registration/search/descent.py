# SPDX-License-Identifier: Apache-2.0
"""
Robust Gauss-Newton steps for many poses of a few points: the kernels of the global search.

The distance of a point comes from the first-order model of the single nearest node of the
gradient-SDF (Sommer et al., CVPR 2022): one fetch, no branches and single precision, so that the
compiler vectorizes the loop over the points. Its error near the surface is a few hundredths of a
millimetre, which is negligible for a search.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.numba_options import kernel, reordered
from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.solver.gauss_newton import solve_cholesky, step_lengths, update

MAX_ROTATION, MAX_TRANSLATION = 0.5, 0.1    # rad and m, of a step

_f = np.float32
_i = np.int32
_v = np.uint32     # unsigned indices need no check for negative values
_u = np.uint64


@kernel
def start_costs(field, points, rotations, places, scale, cost):
    """
    Fill ``cost`` (m * p,) for all m rotations at all p positions, after one Gauss-Newton step each.

    points : (3, n) float32, m, about their centroid
    rotations : (m, 3, 3) float64
    places : (p, 3) float64, m, positions of the centroid in the bone frame
    scale : m, residual at which the weight has fallen to a quarter
    """
    R, t = np.empty((3, 3)), np.empty(3)
    A, b, dx = np.empty((6, 6)), np.empty(6), np.empty(6)
    c2 = _f(scale * scale)
    for i in range(len(rotations)):
        for j in range(len(places)):
            for a in range(3):      # slices would triple the compile time
                t[a] = places[j, a]
                for k in range(3):
                    R[a, k] = rotations[i, a, k]
            _normal_equations(field, False, points, R, t, c2, A, b)
            _step(A, b, dx, R, t)
            cost[i * len(places) + j] = _cost(field, False, points, R, t, c2)


@kernel
def gauss_newton_steps(field, fine, points, R, t, scales, cost):
    """
    Take one Gauss-Newton step per scale from poses R (m, 3, 3), t (m, 3); fill ``cost`` (m,).

    Poses are updated in place. The cost is the mean of e^2 / (e^2 + c^2) (Geman and McClure) with
    the last scale c: far points count at most one, regardless of their distance.
    """
    A, b, dx = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    for q in range(len(R)):
        for s in range(len(scales)):
            c2 = _f(scales[s] * scales[s])
            if fine:    # separate calls: a constant argument gives loops without a branch
                _normal_equations(field, True, points, R[q], t[q], c2, A, b)
            else:
                _normal_equations(field, False, points, R[q], t[q], c2, A, b)
            if not _step(A, b, dx, R[q], t[q]):
                break
        if fine:
            cost[q] = _cost(field, True, points, R[q], t[q], c2)
        else:
            cost[q] = _cost(field, False, points, R[q], t[q], c2)


@kernel
def _step(A, b, dx, R, t):
    """Take the step of the normal equations; return False if A is singular."""
    for i in range(6):
        A[i, i] *= 1.001    # limits sliding of points on a sphere
    if not solve_cholesky(A, b, dx):
        return False
    rotation, translation = step_lengths(dx)
    excess = max(rotation / MAX_ROTATION, translation / MAX_TRANSLATION)
    if excess > 1.0:
        dx /= excess
    update(R, t, dx)
    return True


@reordered
def _nearest(field, fine, x, y, z):
    """Return (distance, gx, gy, gz) at (x, y, z), float32, m from the origin of the grid."""
    voxel, zero, half = _f(field.voxel), _f(0.0), _f(0.5)
    bx, by, bz = field.block_of.shape
    # in coarse cells, clamped to the grid; outside, the plane of the nearest node is extrapolated
    u, v, w = x * _f(1.0 / CELLS) / voxel, y * _f(1.0 / CELLS) / voxel, z * _f(1.0 / CELLS) / voxel
    cu, cv, cw = min(max(u, zero), _f(bx)), min(max(v, zero), _f(by)), min(max(w, zero), _f(bz))
    i, j, k = _i(cu + half), _i(cv + half), _i(cw + half)
    at = _i(field.first_coarse) + (i * _i(by + 1) + j) * _i(bz + 1) + k
    i, j, k = i * _i(CELLS), j * _i(CELLS), k * _i(CELLS)
    if fine:
        ci, cj, ck = min(_i(cu), _i(bx - 1)), min(_i(cv), _i(by - 1)), min(_i(cw), _i(bz - 1))
        block = field.block_of[_u(_v(ci)), _u(_v(cj)), _u(_v(ck))]
        n = _f(CELLS)
        a, b, c = (_i((cu - _f(ci)) * n + half), _i((cv - _f(cj)) * n + half),
                   _i((cw - _f(ck)) * n + half))
        inner = ((block * _i(NODES) + a) * _i(NODES) + b) * _i(NODES) + c
        has = block >= 0
        at = inner if has else at
        i = ci * _i(CELLS) + a if has else i
        j = cj * _i(CELLS) + b if has else j
        k = ck * _i(CELLS) + c if has else k
    row = _u(_v(at))
    gx, gy, gz = field.nodes[row, 1], field.nodes[row, 2], field.nodes[row, 3]
    d = field.nodes[row, 0] + (gx * (x - voxel * _f(i)) + gy * (y - voxel * _f(j))
                               + gz * (z - voxel * _f(k)))
    return d - _f(field.offset), gx, gy, gz


@reordered
def _normal_equations(field, fine, points, R, t, c2, A, b):
    """Fill A (lower triangle) and b (equations 5, 6) with Geman-McClure weights, scale^2 ``c2``."""
    r00, r01, r02 = _f(R[0, 0]), _f(R[0, 1]), _f(R[0, 2])
    r10, r11, r12 = _f(R[1, 0]), _f(R[1, 1]), _f(R[1, 2])
    r20, r21, r22 = _f(R[2, 0]), _f(R[2, 1]), _f(R[2, 2])
    ox, oy, oz = (_f(t[0] - field.origin[0]), _f(t[1] - field.origin[1]),
                  _f(t[2] - field.origin[2]))
    zero = _f(0.0)
    # scalar sums, which the compiler keeps in registers
    a00 = a10 = a11 = a20 = a21 = a22 = a30 = a31 = a32 = a33 = a40 = a41 = a42 = a43 = a44 = zero
    a50 = a51 = a52 = a53 = a54 = a55 = b0 = b1 = b2 = b3 = b4 = b5 = zero
    for k in range(points.shape[1]):
        px, py, pz = points[0, k], points[1, k], points[2, k]
        x = r00 * px + r01 * py + r02 * pz
        y = r10 * px + r11 * py + r12 * pz
        z = r20 * px + r21 * py + r22 * pz
        d, gx, gy, gz = _nearest(field, fine, x + ox, y + oy, z + oz)
        w = c2 / (c2 + d * d)
        w *= w
        j0, j1, j2 = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
        w0, w1, w2, w3, w4, w5 = w * j0, w * j1, w * j2, w * gx, w * gy, w * gz
        a00 += w0 * j0
        a10 += w1 * j0
        a11 += w1 * j1
        a20 += w2 * j0
        a21 += w2 * j1
        a22 += w2 * j2
        a30 += w3 * j0
        a31 += w3 * j1
        a32 += w3 * j2
        a33 += w3 * gx
        a40 += w4 * j0
        a41 += w4 * j1
        a42 += w4 * j2
        a43 += w4 * gx
        a44 += w4 * gy
        a50 += w5 * j0
        a51 += w5 * j1
        a52 += w5 * j2
        a53 += w5 * gx
        a54 += w5 * gy
        a55 += w5 * gz
        b0 -= w0 * d
        b1 -= w1 * d
        b2 -= w2 * d
        b3 -= w3 * d
        b4 -= w4 * d
        b5 -= w5 * d
    A[0, 0], A[1, 0], A[1, 1], A[2, 0], A[2, 1], A[2, 2] = a00, a10, a11, a20, a21, a22
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = a30, a31, a32, a33
    A[4, 0], A[4, 1], A[4, 2], A[4, 3], A[4, 4] = a40, a41, a42, a43, a44
    A[5, 0], A[5, 1], A[5, 2], A[5, 3], A[5, 4], A[5, 5] = a50, a51, a52, a53, a54, a55
    b[0], b[1], b[2], b[3], b[4], b[5] = b0, b1, b2, b3, b4, b5


@reordered
def _cost(field, fine, points, R, t, c2):
    """Return the mean cost of the points; see `gauss_newton_steps`."""
    r00, r01, r02 = _f(R[0, 0]), _f(R[0, 1]), _f(R[0, 2])
    r10, r11, r12 = _f(R[1, 0]), _f(R[1, 1]), _f(R[1, 2])
    r20, r21, r22 = _f(R[2, 0]), _f(R[2, 1]), _f(R[2, 2])
    ox, oy, oz = (_f(t[0] - field.origin[0]), _f(t[1] - field.origin[1]),
                  _f(t[2] - field.origin[2]))
    total = _f(0.0)
    for k in range(points.shape[1]):
        px, py, pz = points[0, k], points[1, k], points[2, k]
        d, _, _, _ = _nearest(field, fine, r00 * px + r01 * py + r02 * pz + ox,
                              r10 * px + r11 * py + r12 * pz + oy,
                              r20 * px + r21 * py + r22 * pz + oz)
        total += d * d / (d * d + c2)
    return total / _f(points.shape[1])
