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
from numpy.typing import NDArray

from gsdf_registration.common.numba_options import kernel
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver.gauss_newton import (
    EXHAUSTED,
    SETTLED,
    SINGULAR,
    damp,
    linearize,
    normal_equations,
    solve_cholesky,
    step_of,
    update,
)
from gsdf_registration.solver.median import median

# m: interference is modelled as uniform within this distance of the bone, as thick as soft tissue
INTERFERENCE_RANGE = 0.006
OUTSIDE = 0.9       # share of the interference that lies outside the bone
# a point this much less likely than its neighbours (3.2 sigma) is interference of its own
LONE = 5.0
EXACTLY = 2.5       # standard deviations
ROOT_2PI = math.sqrt(2.0 * math.pi)


@kernel
def expectation_maximization(field, points, R, t, neighbours, weight, curvature, e, J, history,
                             estimates, strict, exact, cooling, reach, tolerance):
    """
    Run EM with one Gauss-Newton step a round, in place on ``R`` (3, 3), ``t`` (3,).

    points : (n, 3), about their centroid
    neighbours : (n, K) the nearest points of each, itself first
    estimates : (4,) to begin with, and as found: noise (standard deviation of a point), scatter
        (that of the mean residuals), share of the points that are on the bone; last, what
        the scatter may not exceed
    strict : whether the scatter stands as given; else it falls by ``cooling`` a round (graduated
        non-convexity) until it is what is estimated
    exact : whether it is first to fall on to what white noise gives
    reach : interference is sought this far from the bone
    tolerance : a step no longer than this is not taken any more

    Returns (termination, iterations, log-likelihood, whether most points fit exactly); ``weight``
    is the probability that a point is on the bone, ``curvature`` what it adds to what is known of
    the pose.
    """
    n, K = neighbours.shape
    keep = np.ones(n, dtype=np.bool_)
    A = np.zeros((6, 6))
    b = np.zeros(6)
    dx = np.zeros(6)
    mean = np.zeros(n)
    work = np.zeros(2 * n)
    size = math.sqrt((points * points).sum() / n)
    floor = 0.01 * field.voxel      # the field itself is no better
    noise, scatter, share, limit = estimates
    spread = scatter
    settled = False
    last = len(history) - 1
    for iteration in range(len(history)):
        linearize(field, points, R, t, keep, e, J)
        _local_means(e, neighbours, reach, work, mean)
        # Late on, what was estimated stands and steps shrink, or a crease could be crossed for ever
        late = iteration - len(history) // 4
        estimating = late <= 0
        if estimating:
            noise = _white_noise(e, mean, K, reach, floor, work)
        white = noise / math.sqrt(K)
        estimated = strict      # in the round before, if not given: only then may this be the last
        if not strict:
            end = white if exact else spread
            scatter = max(scatter * cooling, end)
            strict = scatter == end
        on_bone, variance, likely = _expectation(e, mean, share, noise, scatter, reach, weight)
        spread = min(max(math.sqrt(variance), white), max(limit, white))
        if strict and estimating:
            share = min(max(on_bone / n, 0.2), 0.98)
            scatter = spread
        history[iteration, 0], history[iteration, 3] = normal_equations(J, e, weight, A, b), likely
        damp(A, history[iteration, 0], size * size)
        if not solve_cholesky(A, b, dx):
            return SINGULAR, iteration, -np.inf, False
        turn, shift = step_of(dx)
        shrink = 1.0 if estimating else 0.9**late
        history[iteration, 1], history[iteration, 2] = shrink * turn, shrink * shift
        # a swing well within the noise is no reason to refuse; a drift is
        step = turn * size + shift
        settled = estimated and shrink * step < tolerance and step < max(0.1 * noise, tolerance)
        if settled or iteration == last:
            break   # so that all that is returned is of this very pose
        dx *= shrink
        update(R, t, dx)
    estimates[0], estimates[1], estimates[2] = noise, scatter, share
    _observe(mean, weight, scatter, curvature)
    # Where most points fit exactly, no model error need be allowed for: with it, a pose half on
    # soft tissue could explain nearly everything
    white = noise / math.sqrt(K)
    fits = _fits_exactly(mean, white)
    return (SETTLED if settled else EXHAUSTED, iteration + 1,
            _log_likelihood(mean, K, share, white if fits else scatter, reach), fits)


@kernel
def _observe(mean, weight, scatter, curvature):
    """
    Fill ``curvature`` with what each point adds to the observed information (Louis 1982).

    What is known less what would be if it were certain which points are on the bone: where that
    hangs on the pose itself, as on an arc that leaves the bone, a point takes away from it.
    """
    for k in range(len(mean)):
        m = mean[k] / scatter
        curvature[k] = weight[k] * (1.0 - (1.0 - weight[k]) * m * m)


@kernel
def _fits_exactly(mean, white):
    """
    Tell whether most points lie on the bone exactly, and hardly any inside it.

    What lies outside may be soft tissue; an error of the model or the tracker lies on both sides.
    """
    on, inside = 0, 0
    for k in range(len(mean)):
        on += abs(mean[k]) < EXACTLY * white
        inside += mean[k] < -EXACTLY * white
    return on > 0.5 * len(mean) and inside < 0.1 * len(mean)


@kernel
def _local_means(e, neighbours, reach, near, mean):
    """Fill ``mean`` (n,) with the mean residual of each point's neighbours, far ones left out."""
    n, K = neighbours.shape
    for k in range(n):
        close = abs(e[k]) < 2.0 * reach
        near[2 * k] = e[k] if close else 0.0
        near[2 * k + 1] = 1.0 if close else 0.0
    for k in range(n):
        total = count = 0.0
        for j in range(K):
            i = np.uint64(2) * np.uint64(neighbours[k, j])      # unsigned: none is negative
            total += near[i]
            count += near[i + np.uint64(1)]
        mean[k] = total / count if count > 0.0 else e[k]


@kernel
def _white_noise(e, mean, K, reach, floor, difference):
    """Return the noise (SD) by differences to the local means, which a wrong pose hardly moves."""
    count = 0
    for k in range(len(e)):
        difference[count] = abs(e[k] - mean[k])
        count += abs(mean[k]) < reach
    # the median absolute deviation; the mean holds 1/K of the point itself
    if count == 0:
        return floor
    return max(1.4826 * median(difference[:count]) / math.sqrt(1.0 - 1.0 / K), floor)


@kernel
def _expectation(e, mean, share, noise, scatter, reach, weight):
    """
    Fill ``weight`` with the probability that each point is on the bone.

    Returns how many are expected to be, the variance of their local means about zero, and how many
    are so rather than not.
    """
    on_bone = squared = likely = 0.0
    inside, outside = _odds_at_zero(share, scatter, reach)
    per_scatter, per_noise = 1.0 / scatter, 1.0 / noise
    for k in range(len(e)):
        m = mean[k] * per_scatter
        r = (e[k] - mean[k]) * per_noise
        odds = (outside if mean[k] > 0.0 else inside) - 0.5 * m * m + min(0.0, LONE - 0.5 * r * r)
        weight[k] = 1.0 / (1.0 + math.exp(-odds)) if odds > -30.0 else 0.0
        on_bone += weight[k]
        squared += weight[k] * mean[k] * mean[k]
        likely += weight[k] > 0.5
    return on_bone, squared / max(on_bone, 1.0), likely


@kernel
def _log_likelihood(mean, K, share, scatter, reach):
    """Return that of the local means, which overlap K-fold among neighbours: each counts 1/K."""
    inside, outside = _odds_at_zero(share, scatter, reach)
    likelihood = len(mean) * math.log((1.0 - share) / reach)
    product = 1.0
    for k in range(len(mean)):
        m = mean[k] / scatter
        odds = (outside if mean[k] > 0.0 else inside) - 0.5 * m * m
        likelihood += max(odds, 0.0)
        # the logarithm of a product is quicker than the sum of logarithms
        product *= (1.0 + math.exp(-abs(odds))) * (OUTSIDE if mean[k] > 0.0 else 1.0 - OUTSIDE)
        if k % 128 == 127:
            likelihood += math.log(product)
            product = 1.0
    return (likelihood + math.log(product)) / K


@kernel
def _odds_at_zero(share, scatter, reach):
    """Return the log-odds of a mean residual next to zero, just inside the bone and outside."""
    odds = math.log(share / (1.0 - share) / (ROOT_2PI * scatter / reach))
    return odds - math.log(1.0 - OUTSIDE), odds - math.log(OUTSIDE)


def patch_likelihood(e: Array, neighbours: NDArray[np.int64], scatter: float) -> float:
    """
    Return the log-likelihood of residuals, with a given standard deviation of their local means.

    Parameters
    ----------
    e : (n,) float, metres
    neighbours : (n, k) int
    scatter : float, metres

    """
    return float(_patch_likelihood(e, neighbours, scatter, INTERFERENCE_RANGE))


@kernel
def _patch_likelihood(e, neighbours, scatter, reach):
    n, K = neighbours.shape
    mean = np.zeros(n)
    _local_means(e, neighbours, reach, np.zeros(2 * n), mean)
    return _log_likelihood(mean, K, 0.5, scatter, reach)
