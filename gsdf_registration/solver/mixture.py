# SPDX-License-Identifier: Apache-2.0
"""
The default method: every point is on the bone or not; how likely follows from what lies round it.

A tracker's noise is white from one sample to the next; soft tissue, another object or a wrong pose
is not.  So the mean residual of a point and its neighbours, whose noise is small, tells bone from
interference long before the point's own residual does.  Expectation maximization (Dempster, Laird,
Rubin 1977) with everything estimated: the noise, the scatter of the means, the share of
interference. Nothing is given up for good.  Soft tissue only ever lies outside, hence the uneven
density of interference.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.solver.gauss_newton import (
    EXHAUSTED,
    SETTLED,
    SINGULAR,
    damp,
    kernel,
    linearize,
    normal_equations,
    solve_cholesky,
    step_of,
    update,
)

OUTSIDE = 0.9       # share of the interference that lies outside the bone
# a point this much less likely than its neighbours (3.2 sigma) is interference of its own
LONE = 5.0
ROOT_2PI = math.sqrt(2.0 * math.pi)


@kernel
def expectation_maximization(field, points, R, t, neighbours, weight, e, J, history, scatter,
                             cooling, reach, model_error, tolerance):
    """
    Run EM with one Gauss-Newton step a round, in place on ``R`` (3, 3), ``t`` (3,).

    points : (n, 3), about their centroid
    neighbours : (n, K) the nearest points of each, itself first
    scatter : standard deviation of the mean residuals to begin with; it falls by ``cooling`` a
        round until it is what white noise gives
        (graduated non-convexity: wide at first, strict in the end), then it is estimated, at most
        ``model_error``
    reach : interference is sought this far from the bone
    tolerance : length of the last step

    Returns (termination, iterations, log-likelihood); ``weight`` is the probability that a point is
    on the bone.
    """
    n, K = neighbours.shape
    keep = np.ones(n, dtype=np.bool_)
    A = np.zeros((6, 6))
    b = np.zeros(6)
    dx = np.zeros(6)
    mean = np.zeros(n)
    size = math.sqrt((points * points).sum() / n)
    floor = 0.01 * field.voxel      # the field itself is no better
    share = 0.7
    noise = floor
    strict = settled = False
    for iteration in range(len(history)):
        linearize(field, points, R, t, keep, e, J)
        _local_means(e, neighbours, reach, mean)
        # Late on, what was estimated stands and steps shrink, or a crease could be crossed for ever
        late = iteration - len(history) // 4
        estimating = late <= 0
        if estimating:
            noise = _white_noise(e, mean, K, reach, floor)
        white = noise / math.sqrt(K)
        if not strict:
            scatter = max(scatter * cooling, white)
            strict = scatter == white
        _expectation(e, mean, K, share, noise, scatter, reach, weight)
        if strict and estimating:
            share = min(max(weight.mean(), 0.2), 0.98)
            scatter = min(
                max(math.sqrt((weight * mean * mean).sum() / max(weight.sum(), 1.0)), white),
                max(model_error, white))
        history[iteration, 0] = normal_equations(J, e, weight, A, b)
        damp(A, history[iteration, 0], size * size)
        history[iteration, 3] = (weight > 0.5).sum()
        if not solve_cholesky(A, b, dx):
            return SINGULAR, iteration, -np.inf
        turn, shift = step_of(dx)
        shrink = 1.0 if estimating else 0.9**late
        dx *= shrink
        update(R, t, dx)
        history[iteration, 1], history[iteration, 2] = shrink * turn, shrink * shift
        # a swing well within the noise is no reason to refuse; a drift is
        step = turn * size + shift
        settled = strict and shrink * step < tolerance and step < max(0.1 * noise, tolerance)
        if settled:
            break
    linearize(field, points, R, t, keep, e, J)
    _local_means(e, neighbours, reach, mean)
    # Of two poses the one on which more points lie exactly is right: were the model's own error
    # allowed for, a pose half on soft tissue could explain nearly everything
    likelihood = _expectation(e, mean, K, share, noise, noise / math.sqrt(K), reach, weight)
    _expectation(e, mean, K, share, noise, scatter, reach, weight)
    return SETTLED if settled else EXHAUSTED, iteration + 1, likelihood


@kernel
def _local_means(e, neighbours, reach, mean):
    """Fill ``mean`` (n,) with the mean residual of each point's neighbours, far ones left out."""
    n, K = neighbours.shape
    for k in range(n):
        total = 0.0
        count = 0
        for j in range(K):
            r = e[neighbours[k, j]]
            if abs(r) < 2.0 * reach:
                total += r
                count += 1
        mean[k] = total / count if count else e[k]


@kernel
def _white_noise(e, mean, K, reach, floor):
    """Return the noise (SD) by differences to the local means, which a wrong pose hardly moves."""
    difference = np.empty(len(e))
    count = 0
    for k in range(len(e)):
        if abs(mean[k]) < reach:
            difference[count] = abs(e[k] - mean[k])
            count += 1
    # the median absolute deviation; the mean holds 1/K of the point itself
    noise = 1.4826 * np.median(difference[:count]) / math.sqrt(1.0 - 1.0 / K) if count else 0.0
    return max(noise, floor)


@kernel
def _expectation(e, mean, K, share, noise, scatter, reach, weight):
    """
    Fill ``weight`` with the probability that each point is on the bone; return log-likelihood.

    It is that of the local means, which overlap K-fold among neighbours, so each counts 1/K.
    """
    prior = math.log(share / (1.0 - share))
    likelihood = 0.0
    for k in range(len(e)):
        interference = (OUTSIDE if mean[k] > 0.0 else 1.0 - OUTSIDE) / reach
        m = mean[k] / scatter
        r = (e[k] - mean[k]) / noise
        patch = prior - 0.5 * m * m - math.log(ROOT_2PI * scatter * interference)
        odds = patch + min(0.0, LONE - 0.5 * r * r)
        weight[k] = 1.0 / (1.0 + math.exp(-odds)) if odds > -30.0 else 0.0
        likelihood += max(patch, 0.0) + math.log1p(math.exp(-abs(patch))) + math.log(
            (1.0 - share) * interference)
    return likelihood / K


@kernel
def patch_likelihood(e, neighbours, scatter, reach):
    """Return the log-likelihood of residuals ``e`` (n,) whose local means scatter by so much."""
    n, K = neighbours.shape
    mean = np.zeros(n)
    _local_means(e, neighbours, reach, mean)
    return _expectation(e, mean, K, 0.5, np.inf, scatter, reach, np.zeros(n))
