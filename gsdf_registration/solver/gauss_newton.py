# SPDX-License-Identifier: Apache-2.0
"""
One Gauss-Newton step on the gradient-SDF, compiled; what every solver here is made of.

The unknown is ``T_bone_tracker = (R, t)`` with points taken relative to their centroid, so that t
is where the centroid lies in the bone frame and the two halves of a step, rotation about the
centroid and translation, hardly couple.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from gsdf_registration.field.sample import sample

kernel = nb.njit(nogil=True, cache=True, error_model='numpy', fastmath={'contract'})


@kernel
def linearize(field, points, R, t, keep, e, J):
    """
    Fill residuals ``e`` (n,) and derivatives ``J`` (n, 6) at the pose; skip points not in ``keep``.

    Equation 1: e_k = SDF(R p_k + t); 5 and 6: J_k = grad SDF . [-(R p_k)^, I], rotation first.
    """
    for k in range(len(points)):
        if not keep[k]:
            continue
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        x = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz
        y = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz
        z = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz
        d, gx, gy, gz = sample(field, x + t[0], y + t[1], z + t[2])
        e[k] = d
        J[k, 0] = y * gz - z * gy   # g . (w x Rp) = w . (Rp x g)
        J[k, 1] = z * gx - x * gz
        J[k, 2] = x * gy - y * gx
        J[k, 3] = gx
        J[k, 4] = gy
        J[k, 5] = gz


@kernel
def normal_equations(J, e, w, A, b):
    """Fill ``A`` = J^T W J (lower triangle) and ``b`` = -J^T W e; return the cost sum w e^2."""
    A[:] = 0.0
    b[:] = 0.0
    cost = 0.0
    for k in range(len(e)):
        if w[k] == 0.0:
            continue
        cost += w[k] * e[k] * e[k]
        for i in range(6):
            wj = w[k] * J[k, i]
            b[i] -= wj * e[k]
            for j in range(i + 1):
                A[i, j] += wj * J[k, j]
    return cost


@kernel
def damp(A, cost, size2):
    """
    Add Levenberg damping that vanishes with the cost (m^2), as in Fan and Yuan 2005.

    ``size2``: mean square of the points, m^2.
    Far from the bone all gradients are nearly parallel and a bare step would go anywhere; near it
    this changes no digit that counts.
    """
    for i in range(3):
        A[i, i] += 0.1 * cost
        A[i + 3, i + 3] += 0.1 * cost / size2


@kernel
def solve_cholesky(A, b, x):
    """
    Solve A x = b by the lower triangle of ``A`` (6, 6), overwriting it; False if A is singular.

    A pivot is called zero relative to its own diagonal, so that the unit of length does not matter.
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
    """Apply X (+) dX = (exp(xi^) R, t + phi) in place, dX = [xi, phi] (equations 2-3)."""
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
def step_of(dx):
    """Return the lengths of the two halves of a step: radians and metres."""
    return (math.sqrt(dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]),
            math.sqrt(dx[3] * dx[3] + dx[4] * dx[4] + dx[5] * dx[5]))


# How a solver ended.
SETTLED, EXHAUSTED, SINGULAR = range(3)
TERMINATION = ('the weights settled', 'the iterations ran out', 'the points do not hold the pose')

# Columns of a history row: cost, rotation step, translation step, points in use.
HISTORY = 4


def empty_history(rows: int) -> np.ndarray:
    """Return the (rows, 4) array a solver fills: cost m^2, step rad, step m, points in use."""
    return np.zeros((rows, HISTORY))
