# SPDX-License-Identifier: Apache-2.0
"""
The last step: what noise does to distances on average, and how it differs from axis to axis.

A noisy point of a curved bone lies outside it on average, by half the noise's variance times the
divergence of the normals: 0.01 mm on a femoral head at 0.5 mm, 0.04 mm at 1 mm, more on ridges;
about what a thousand points leave open.  And no tracker sees as well along its line of sight as
across.  Both are small, so one step from where `mixture` ended is enough (Le Cam's one-step
estimator): residuals less what noise is expected to make of them, gradients as it is expected to
blur them, both by the unscented transform (Julier and Uhlmann 1997), and each point weighed by the
noise along its normal.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import kernel
from gsdf_registration.field.sample import BATCH, sample_batch
from gsdf_registration.solver.gauss_newton import (
    normal_equations,
    solve_cholesky,
    turn_by,
    update,
    write_rows,
)

ROUND = 20.0        # points' worth of belief that the noise is the same along all axes
FLATTEST = 0.1      # of the mean variance: no axis is better than that


@kernel
def bias_correction(field, points, R, t, weight, noise, e, J, precision):
    """
    Take one more step, in place on ``R`` (3, 3), ``t`` (3,).

    points : (n, 3), about their centroid
    weight : (n,) probability that a point is on the bone
    noise : standard deviation of a point along the normal
    e, J : (n,), (n, 6) residuals and derivatives there; afterwards at the new pose, less what
        noise makes of them
    precision : (n,) filled with the noise over that along the normal of each point

    False, and no step, if the points do not hold the pose.
    """
    _expect(field, points, R, t, weight, noise, e, J)
    _weigh(e, J, weight, precision)
    n = len(e)
    w = np.empty(n)
    for k in range(n):
        w[k] = weight[k] * precision[k] * precision[k]
    A, b, dx = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    normal_equations(J, e, w, A, b)
    if not solve_cholesky(A, b, dx):
        return False
    update(R, t, dx)
    for k in range(n):
        for i in range(6):
            e[k] += J[k, i] * dx[i]
    return True


@kernel
def _expect(field, points, R, t, weight, noise, e, J):
    """
    Take from ``e`` the mean distance of a noisy point of the surface, and make ``J`` mean as well.

    Over six points about the nearest of the surface, along the bone's own axes, whose mean and
    variance are those of the noise.
    """
    which = np.empty(BATCH, np.uint64)
    arm, near = np.empty((3, BATCH)), np.empty((3, BATCH))
    value, total = np.empty((4, BATCH), np.float32), np.empty((4, BATCH))
    n = 0
    for k in range(len(points)):
        which[n] = k
        n += weight[k] > 0.0
        if n == BATCH or k + 1 == len(points):
            turn_by(points, which, n, R, arm)
            for j in range(n):
                row = which[j]
                for i in range(3):
                    near[i, j] = arm[i, j] - e[row] * J[row, 3 + i]
            _sum_around(field, near, t, n, math.sqrt(3.0) * noise, value, total)
            for j in range(n):
                value[0, j] = e[which[j]] - total[0, j] / 6.0
                for i in range(1, 4):
                    value[i, j] = total[i, j] / 6.0
            write_rows(which, n, arm, value, e, J)
            n = 0


@kernel
def _sum_around(field, x, t, n, spread, value, total):
    """Fill ``total`` (4, BATCH) with the sums of six samples, ``spread`` off along each axis."""
    total[:] = 0.0
    for i in range(3):
        for shift in (spread, -2.0 * spread):
            for j in range(n):
                x[i, j] += shift
            sample_batch(field, x, t, n, value)
            for j in range(n):
                for c in range(4):
                    total[c, j] += value[c, j]
        for j in range(n):
            x[i, j] += spread


@kernel
def _weigh(e, J, weight, precision):
    """
    Fill ``precision`` (n,) with the mean noise over that along the normal of each point.

    The variance along a normal g is g^T S g; S by least squares to the squared residuals, drawn
    to a multiple of the identity by `ROUND` points' worth.
    """
    A, b, s = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    row = np.empty(6)
    total = squared = 0.0
    for k in range(len(e)):
        total += weight[k]
        squared += weight[k] * e[k] * e[k]
        _products(J, k, row)
        for i in range(6):
            b[i] += weight[k] * row[i] * e[k] * e[k]
            for j in range(i + 1):
                A[i, j] += weight[k] * row[i] * row[j]
    mean = squared / max(total, 1e-300)
    for i in range(6):      # of the identity are the squares, and each product counts twice
        A[i, i] += ROUND if i < 3 else 2.0 * ROUND
        b[i] += ROUND * mean if i < 3 else 0.0
    solve_cholesky(A, b, s)
    for k in range(len(e)):
        _products(J, k, row)
        variance = 0.0
        for i in range(6):
            variance += row[i] * s[i]
        even = mean * (row[0] + row[1] + row[2])        # if all axes were alike
        precision[k] = math.sqrt(even / max(variance, FLATTEST * even)) if even > 0.0 else 1.0


@kernel
def _products(J, k, row):
    """Fill ``row`` (6,) with the products of which g^T S g is the sum, g the gradient of J_k."""
    x, y, z = J[k, 3], J[k, 4], J[k, 5]
    row[0], row[1], row[2] = x * x, y * y, z * z
    row[3], row[4], row[5] = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
