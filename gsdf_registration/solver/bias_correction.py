# SPDX-License-Identifier: Apache-2.0
"""
Correct the bias of noisy points on a curved bone, and weight points by anisotropic noise.

A noisy point of a curved bone lies outside it on average, by half the variance of the noise times
the divergence of the normals: 0.01 mm on a femoral head at 0.5 mm of noise, 0.04 mm at 1 mm, more
on ridges. This is as large as the random error of a pose from a thousand points. A tracker is also
less accurate along its line of sight than across. Both effects are small, so one step after
`mixture` has converged is enough (Le Cam's one-step estimator). It subtracts the expected bias from
residuals and uses expected gradients, both by the unscented transform (Julier and Uhlmann 1997),
and weights each point by the noise along its normal.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import kernel
from gsdf_registration.field.sample import BATCH, sample_batch
from gsdf_registration.solver.gauss_newton import (
    linearize,
    normal_equations,
    rotate,
    solve_cholesky,
    update,
    write_rows,
)
from gsdf_registration.solver.mixture import local_means

PRIOR_POINTS = 20.0     # weight of the prior that the noise is isotropic, in points
MIN_VARIANCE = 0.1      # of the mean variance: lower limit along any axis


@kernel
def bias_correction(field, points, R, t, weight, noise, e, J, precision, neighbours, thickness):
    """
    Take one corrective step, in place on ``R`` (3, 3), ``t`` (3,).

    points : (n, 3), about their centroid
    weight : (n,) probability that a point is on the bone
    noise : standard deviation of a point along the normal
    e, J : (n,), (n, 6) residuals and derivatives at the pose; updated to the new pose, without bias
    precision : (n,) filled with the mean noise over the noise along the normal of each point on a
        stroke; that of touches, which follow, is given: there are too few to tell the directions
        apart
    neighbours : (s, K) nearest neighbours of each point on a stroke, itself first
    thickness : of the layer around the bone in which interference is modelled

    Returns False, and takes no step, if the points do not constrain the pose.
    """
    _remove_bias(field, points, R, t, weight, noise, e, J, precision)
    n, s = len(e), len(neighbours)
    # what neighbours share is an error of the model or the pose, not noise
    shared = np.empty(n)
    local_means(e, neighbours, thickness, np.empty(2 * s), shared)
    _estimate_precision(e[:s] - shared[:s], J[:s], weight[:s], precision[:s])
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
def unbiased_rows(field, points, R, t, weight, noise, e, J, precision):
    """Fill residuals ``e`` (n,) and derivatives ``J`` (n, 6) at the pose, without bias."""
    linearize(field, points, R, t, np.ones(len(points), dtype=np.bool_), e, J)
    _remove_bias(field, points, R, t, weight, noise, e, J, precision)


@kernel
def _remove_bias(field, points, R, t, weight, noise, e, J, precision):
    """
    Subtract the expected distance of a noisy surface point from ``e``, and average ``J``.

    The average is over six sigma points about the nearest surface point, along the axes of the bone
    frame, with the mean and variance of the noise.
    """
    which = np.empty(BATCH, np.uint64)
    arm, near = np.empty((3, BATCH)), np.empty((3, BATCH))
    value, total = np.empty((4, BATCH), np.float32), np.empty((4, BATCH))
    spread = np.empty(BATCH)
    n = 0
    for k in range(len(points)):
        which[n] = k
        n += weight[k] > 0.0
        if n == BATCH or k + 1 == len(points):
            rotate(points, which, n, R, arm)
            for j in range(n):
                row = which[j]
                spread[j] = math.sqrt(3.0) * (noise / precision[row])
                for i in range(3):
                    near[i, j] = arm[i, j] - e[row] * J[row, 3 + i]
            _sum_around(field, near, t, n, spread, value, total)
            for j in range(n):
                value[0, j] = e[which[j]] - total[0, j] / 6.0
                for i in range(1, 4):
                    value[i, j] = total[i, j] / 6.0
            write_rows(which, n, arm, value, e, J)
            n = 0


@kernel
def _sum_around(field, x, t, n, spread, value, total):
    """Fill ``total`` (4, BATCH) with sums over six samples at +-``spread`` along each axis."""
    total[:] = 0.0
    for i in range(3):
        for steps in (1.0, -2.0):
            for j in range(n):
                x[i, j] += steps * spread[j]
            sample_batch(field, x, t, n, value)
            for j in range(n):
                for c in range(4):
                    total[c, j] += value[c, j]
        for j in range(n):
            x[i, j] += spread[j]


@kernel
def _estimate_precision(e, J, weight, precision):
    """
    Fill ``precision`` (n,) with the mean noise over the noise along the normal of each point.

    The variance along a normal g is g^T S g. S is fitted to the squared differences ``e`` of the
    residuals from those of their neighbours by least squares, with an isotropic prior worth
    `PRIOR_POINTS` points.
    """
    A, b, s = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    row = np.empty(6)
    total = squared = 0.0
    for k in range(len(e)):
        total += weight[k]
        squared += weight[k] * e[k] * e[k]
        _quadratic_terms(J, k, row)
        for i in range(6):
            b[i] += weight[k] * row[i] * e[k] * e[k]
            for j in range(i + 1):
                A[i, j] += weight[k] * row[i] * row[j]
    mean = squared / max(total, 1e-300)
    for i in range(6):      # the identity has only squares, and each product counts twice
        A[i, i] += PRIOR_POINTS if i < 3 else 2.0 * PRIOR_POINTS
        b[i] += PRIOR_POINTS * mean if i < 3 else 0.0
    solve_cholesky(A, b, s)
    for k in range(len(e)):
        _quadratic_terms(J, k, row)
        variance = 0.0
        for i in range(6):
            variance += row[i] * s[i]
        isotropic = mean * (row[0] + row[1] + row[2])   # variance if the noise is isotropic
        precision[k] = 1.0
        if isotropic > 0.0:
            precision[k] = math.sqrt(isotropic / max(variance, MIN_VARIANCE * isotropic))


@kernel
def _quadratic_terms(J, k, row):
    """Fill ``row`` (6,) with the coefficients of S in g^T S g, g the gradient in row k of J."""
    x, y, z = J[k, 3], J[k, 4], J[k, 5]
    row[0], row[1], row[2] = x * x, y * y, z * z
    row[3], row[4], row[5] = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
