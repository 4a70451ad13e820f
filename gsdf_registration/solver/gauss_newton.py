# SPDX-License-Identifier: Apache-2.0
"""
Compiled parts of a Gauss-Newton step on the gradient-SDF, shared by all solvers.

The unknown is ``T_bone_tracker = (R, t)`` of the points relative to their centroid: t is the
position of the centroid in the bone frame, and rotation about the centroid and translation hardly
couple.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import inlined_kernel, kernel
from gsdf_registration.field.sample import BATCH, sample_batch


@kernel
def linearize(field, points, R, t, keep, e, J):
    """
    Fill residuals ``e`` (n,) and derivatives ``J`` (n, 6) at the pose.

    Points with ``keep`` (n,) false are skipped.
    Equation 1: e_k = SDF(R p_k + t); 5 and 6: J_k = grad SDF . [-(R p_k)^, I], rotation first.
    """
    which = np.empty(BATCH, np.uint64)
    arm = np.empty((3, BATCH))
    value = np.empty((4, BATCH), np.float32)
    n = 0
    for k in range(len(points)):
        which[n] = k
        n += keep[k]
        if n == BATCH or k + 1 == len(points):
            rotate(points, which, n, R, arm)
            sample_batch(field, arm, t, n, value)
            write_rows(which, n, arm, value, e, J)
            n = 0


@kernel
def rotate(points, which, n, R, arm):
    """Fill ``arm`` (3, n), R p of the points with indices ``which``."""
    for k in range(n):
        x, y, z = points[which[k], 0], points[which[k], 1], points[which[k], 2]
        arm[0, k] = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        arm[1, k] = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        arm[2, k] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z


@kernel
def write_rows(which, n, arm, value, e, J):
    """Write the sampled distances and gradients to rows ``which`` of ``e`` and ``J``."""
    for k in range(n):
        x, y, z = arm[0, k], arm[1, k], arm[2, k]
        gx, gy, gz = float(value[1, k]), float(value[2, k]), float(value[3, k])
        row = which[k]
        e[row] = value[0, k]
        J[row, 0] = y * gz - z * gy   # g . (w x Rp) = w . (Rp x g)
        J[row, 1] = z * gx - x * gz
        J[row, 2] = x * gy - y * gx
        J[row, 3] = gx
        J[row, 4] = gy
        J[row, 5] = gz


@inlined_kernel
def _plus(s, a, j):
    """Return s + a j, where s and j are tuples of six."""
    return (s[0] + a * j[0], s[1] + a * j[1], s[2] + a * j[2], s[3] + a * j[3], s[4] + a * j[4],
            s[5] + a * j[5])


@kernel
def normal_equations(J, e, w, A, b):
    """Fill ``A`` = J^T W J (lower triangle) and ``b`` = -J^T W e; return the cost sum w e^2."""
    # tuples stay in registers, whereas arrays would be read and written for every point; elements
    # above the diagonal are never used, so the compiler omits them
    x0 = x1 = x2 = x3 = x4 = x5 = y = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cost = 0.0
    for k in range(len(e)):
        if w[k] == 0.0:
            continue
        j = (J[k, 0], J[k, 1], J[k, 2], J[k, 3], J[k, 4], J[k, 5])
        x0, x1, x2 = _plus(x0, w[k] * j[0], j), _plus(x1, w[k] * j[1], j), _plus(x2, w[k] * j[2], j)
        x3, x4, x5 = _plus(x3, w[k] * j[3], j), _plus(x4, w[k] * j[4], j), _plus(x5, w[k] * j[5], j)
        y = _plus(y, -w[k] * e[k], j)
        cost += w[k] * e[k] * e[k]
    A[0, 0] = x0[0]
    A[1, 0], A[1, 1] = x1[:2]
    A[2, 0], A[2, 1], A[2, 2] = x2[:3]
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = x3[:4]
    A[4, 0], A[4, 1], A[4, 2], A[4, 3], A[4, 4] = x4[:5]
    A[5, 0], A[5, 1], A[5, 2], A[5, 3], A[5, 4], A[5, 5] = x5
    b[0], b[1], b[2], b[3], b[4], b[5] = y
    return cost


@kernel
def damp(A, cost, size2):
    """
    Add Levenberg damping proportional to the cost (m^2), as in Fan and Yuan 2005.

    ``size2``: mean square of the points, m^2.
    Far from the bone, all gradients are nearly parallel and an undamped step is arbitrary; near the
    bone the damping is negligible.
    """
    for i in range(3):
        A[i, i] += 0.1 * cost
        A[i + 3, i + 3] += 0.1 * cost / size2


@kernel
def solve_cholesky(A, b, x):
    """
    Solve A x = b from the lower triangle of ``A`` (6, 6), which is overwritten.

    Returns False if A is singular: a pivot is zero relative to its diagonal element, so that the
    unit of length does not matter.
    """
    n = len(b)
    for i in range(n):
        diagonal = A[i, i]
        for j in range(i + 1):
            s = A[i, j]
            for m in range(j):
                s -= A[i, m] * A[j, m]
            if j < i:
                A[i, j] = s / A[j, j]
            elif s > 1e-10 * diagonal:
                A[i, i] = math.sqrt(s)
            else:
                return False
    for i in range(n):
        s = b[i]
        for m in range(i):
            s -= A[i, m] * x[m]
        x[i] = s / A[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for m in range(i + 1, n):
            s -= A[m, i] * x[m]
        x[i] = s / A[i, i]
    return True


@kernel
def update(R, t, dx):
    """Apply X (+) dX = (exp(xi^) R, t + phi) in place, dX = [xi, phi] (equations 2, 3)."""
    a, b, c = dx[0], dx[1], dx[2]
    angle = math.sqrt(a * a + b * b + c * c)
    if angle > 0.0:
        half = math.sin(0.5 * angle) / angle
        qw, qx, qy, qz = math.cos(0.5 * angle), half * a, half * b, half * c
        for j in range(3):
            x, y, z = R[0, j], R[1, j], R[2, j]
            # v + 2 qw (q x v) + 2 q x (q x v)
            ux, uy, uz = 2.0 * (qy * z - qz * y), 2.0 * (qz * x - qx * z), 2.0 * (qx * y - qy * x)
            R[0, j] = x + qw * ux + (qy * uz - qz * uy)
            R[1, j] = y + qw * uy + (qz * ux - qx * uz)
            R[2, j] = z + qw * uz + (qx * uy - qy * ux)
    for i in range(3):
        t[i] += dx[3 + i]
    return angle


@kernel
def step_lengths(dx):
    """Return the lengths of the rotation (rad) and the translation (m) of a step."""
    return (math.sqrt(dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]),
            math.sqrt(dx[3] * dx[3] + dx[4] * dx[4] + dx[5] * dx[5]))


# Why a solver stopped
CONVERGED, MAX_ITERATIONS, SINGULAR = range(3)
TERMINATION = ('converged', 'the maximum number of iterations was reached',
               'the points do not constrain the pose')


def empty_history(rows: int) -> np.ndarray:
    """Return (rows, 4), one row per iteration: cost m^2, rotation rad, translation m, inliers."""
    return np.zeros((rows, 4))
