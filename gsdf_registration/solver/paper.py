# SPDX-License-Identifier: Apache-2.0
"""
The published method: Gauss-Newton with Cauchy IRLS that discards outliers.

T. Li et al., "Partial-to-Full Registration based on Gradient-SDF for Computer-Assisted Orthopedic
Surgery", arXiv 2410.03078, Algorithm 1. It is kept as published, for comparison: a discarded point
is never used again.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.numba_options import kernel
from gsdf_registration.solver.gauss_newton import (
    CONVERGED,
    MAX_ITERATIONS,
    SINGULAR,
    damp,
    linearize,
    normal_equations,
    solve_cholesky,
    step_lengths,
    update,
)

# Parameters of Algorithm 1
DISCARD_BELOW = 0.1         # delta: points of lower weight are discarded
WEIGHT_TOLERANCE = 1e-3     # epsilon: IRLS has converged if the weights change less (RMS)
HOLD = 2                    # number of consecutive iterations in which this must be met


@kernel
def algorithm_1(field, points, R, t, keep, weight, e, J, history,
                cauchy_scale, discard_below, weight_tolerance, hold):
    """
    Run Algorithm 1 in place on ``R`` (3, 3), ``t`` (3,); return (termination, iterations).

    ``keep`` (n,) bool is cleared for discarded points; ``weight``, ``e`` (n,) and ``J`` (n, 6) are
    filled at the returned pose. ``history`` has a row for each allowed iteration.
    """
    A = np.zeros((6, 6))
    size2 = (points * points).sum() / len(points)
    b = np.zeros(6)
    dx = np.zeros(6)
    met = 0
    for iteration in range(len(history)):
        linearize(field, points, R, t, keep, e, J)
        change = _reweight(e, keep, weight, cauchy_scale)
        inliers = keep.sum()
        # IRLS has converged when ||w_i - w_(i-1)|| <= epsilon
        met = met + 1 if change <= weight_tolerance * weight_tolerance * inliers else 0
        if met >= hold:
            if _discard(keep, weight, discard_below) == 0:
                return CONVERGED, iteration
            met = 0
        history[iteration, 0] = normal_equations(J, e, weight, A, b)
        damp(A, history[iteration, 0], size2)
        history[iteration, 3] = inliers
        if not solve_cholesky(A, b, dx):
            return SINGULAR, iteration
        update(R, t, dx)
        history[iteration, 1], history[iteration, 2] = step_lengths(dx)
    linearize(field, points, R, t, keep, e, J)
    _reweight(e, keep, weight, cauchy_scale)
    return MAX_ITERATIONS, len(history)


@kernel
def _reweight(e, keep, weight, c):
    """Set w(e) = 1 / (1 + (e/c)^2), equations 9 and 13, c in m; return ||w_i - w_(i-1)||^2."""
    change = 0.0
    for k in range(len(e)):
        if keep[k]:
            r = e[k] / c
            w = 1.0 / (1.0 + r * r)
            change += (w - weight[k]) ** 2
            weight[k] = w
    return change


@kernel
def _discard(keep, weight, delta):
    """Permanently discard the points with w < delta; return how many."""
    dropped = 0
    for k in range(len(weight)):
        if keep[k] and weight[k] < delta:
            keep[k] = False
            weight[k] = 0.0
            dropped += 1
    return dropped
