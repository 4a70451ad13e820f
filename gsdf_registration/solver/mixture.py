# SPDX-License-Identifier: Apache-2.0
"""
The default method: a mixture of points on the bone and interference.

Tracker noise is white from one sample to the next; the residuals of soft tissue, of another object
or of a wrong pose are not. The mean residual of a point and its neighbours contains little noise,
so it separates bone from interference much earlier than the residual of the point itself. The
mixture is solved by expectation maximization (Dempster, Laird, Rubin 1977), which also estimates
the noise, the standard deviation of the local means and the inlier ratio. No point is discarded
permanently. Soft tissue lies outside the bone, so the density of interference is higher there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.numba_options import kernel
from gsdf_registration.common.rigid import Array
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
from gsdf_registration.solver.median import median
from gsdf_registration.solver.touches import (
    NO_TOUCHES,
    touch_expectation,
    touch_likelihood,
    touch_noise,
    touch_variances,
)

# m: interference is modelled as uniform within this distance of the bone, about the thickness of
# soft tissue left on an exposed bone
INTERFERENCE_RANGE = 0.006
OUTSIDE_SHARE = 0.9     # of the interference lies outside the bone
# excess of a point's -log-likelihood over its neighbours' (3.2 sigma) from which it is an outlier
OUTLIER_EXCESS = 5.0
CONSISTENT = 2.5        # standard deviations
ROOT_2PI = math.sqrt(2.0 * math.pi)


@kernel
def expectation_maximization(field, points, R, t, neighbours, touches, weight, curvature, e, J,
                             precision, history, estimates, annealed, anneal_to_noise,
                             annealing_factor, thickness, tolerance):
    """
    Run EM with one Gauss-Newton step per iteration, in place on ``R`` (3, 3), ``t`` (3,).

    points : (n, 3), about their centroid, first those on strokes, then touches
    neighbours : (s, K) nearest neighbours of each point on a stroke, itself first
    touches : (n - s,) relative noise of each touch
    estimates : (4,) initial values, updated: noise (standard deviation of a point), standard
        deviation of the local means, inlier ratio; last the limit of the second, not updated
    annealed : whether the standard deviation of the local means starts at its estimate; if false,
        it falls by ``annealing_factor`` per iteration (graduated non-convexity) until it gets there
    anneal_to_noise : whether it is annealed down to the value that white noise gives
    thickness : of the layer around the bone in which interference is modelled
    tolerance : EM stops when the step is shorter

    Returns (termination, iterations, log-likelihood, whether the points are consistent with white
    noise). ``weight`` is filled with the probability that a point is on the bone, ``curvature``
    with the information that it contributes, ``precision`` with the noise over that of a point.
    """
    s, K = neighbours.shape
    n = len(points)
    keep = np.ones(n, dtype=np.bool_)
    A = np.zeros((6, 6))
    b = np.zeros(6)
    dx = np.zeros(6)
    mean = np.zeros(n)
    work = np.zeros(2 * n)
    variance, scaled = np.zeros(n - s), np.zeros(n)
    size = math.sqrt((points * points).sum() / n)
    floor = 0.01 * field.voxel      # accuracy of the field itself
    noise, local_sd, inlier_ratio, limit = estimates
    spread = local_sd
    converged = False
    last = len(history) - 1
    for iteration in range(len(history)):
        linearize(field, points, R, t, keep, e, J)
        local_means(e, neighbours, thickness, work, mean)
        # In late iterations the estimates are frozen and steps shrink; otherwise the pose could
        # oscillate across a crease
        late = iteration - len(history) // 4
        estimating = late <= 0
        if estimating and s > 0:
            noise = _white_noise(e[:s], mean[:s], K, thickness, floor, work)
        white = noise / math.sqrt(K)
        estimated = annealed    # in the previous iteration, which the last one requires
        if not annealed:
            end = white if anneal_to_noise else spread
            local_sd = max(local_sd * annealing_factor, end)
            annealed = local_sd == end
        on_bone, squared, likely = _expectation(e[:s], mean[:s], inlier_ratio, noise, local_sd,
                                                thickness, weight[:s])
        spread = min(max(math.sqrt(squared), white), max(limit, white))
        if s < n:
            # what widens the local means widens touches: the error of the model and of the pose
            touch_variances(touches, noise, max(local_sd * local_sd - white * white, 0.0), variance)
            more, probable = touch_expectation(e[s:], variance, inlier_ratio, thickness,
                                               OUTSIDE_SHARE, weight[s:])
            on_bone, likely = on_bone + more, likely + probable
            if s == 0:
                spread = touch_noise(e, touches, weight, floor)
                noise = spread if estimating else noise
        _scale_weights(weight, s, variance, noise if s > 0 else local_sd, scaled, precision)
        if annealed and estimating:
            inlier_ratio = min(max(on_bone / n, 0.2), 0.98)
            local_sd = spread
        history[iteration, 0], history[iteration, 3] = normal_equations(J, e, scaled, A, b), likely
        damp(A, history[iteration, 0], size * size)
        if not solve_cholesky(A, b, dx):
            return SINGULAR, iteration, -np.inf, False
        turn, shift = step_lengths(dx)
        shrink = 1.0 if estimating else 0.9**late
        history[iteration, 1], history[iteration, 2] = shrink * turn, shrink * shift
        # an oscillation well within the noise counts as converged; a drift does not
        step = turn * size + shift
        converged = estimated and shrink * step < tolerance and step < max(0.1 * noise, tolerance)
        if converged or iteration == last:
            break   # before the update, so that all results belong to this pose
        dx *= shrink
        update(R, t, dx)
    estimates[0], estimates[1], estimates[2] = noise, local_sd, inlier_ratio
    _observed_information(mean, weight, local_sd, s, variance, curvature)
    # Where most points fit exactly, the likelihood allows for no model error: otherwise it could
    # explain nearly all points at a pose that is half on soft tissue
    white = noise / math.sqrt(K)
    consistent = s == 0 or _is_consistent(mean[:s], white)
    likelihood = _log_likelihood(mean[:s], K, inlier_ratio, white if consistent else local_sd,
                                 thickness)
    likelihood += touch_likelihood(e[s:], variance, inlier_ratio, thickness, OUTSIDE_SHARE)
    return CONVERGED if converged else MAX_ITERATIONS, iteration + 1, likelihood, consistent


@kernel
def _scale_weights(weight, first, variance, noise, scaled, precision):
    """Fill the weights of the residuals, and the precision of touches, which follow ``first``."""
    for k in range(len(weight)):
        scaled[k] = weight[k]
    for k in range(first, len(weight)):
        relative = noise * noise / variance[k - first]
        scaled[k] *= relative
        precision[k] = math.sqrt(relative)


@kernel
def _observed_information(mean, weight, local_sd, first, variance, curvature):
    """
    Fill ``curvature`` with the contribution of each point to the observed information (Louis 1982).

    It is the complete-data information less the part missing because the class of a point, bone or
    interference, is uncertain. Where the class depends on the pose, as along an arc that leaves the
    bone, the contribution is negative. Touches follow ``first``.
    """
    for k in range(len(mean)):
        m = mean[k] / (local_sd if k < first else math.sqrt(variance[k - first]))
        curvature[k] = weight[k] * (1.0 - (1.0 - weight[k]) * m * m)


@kernel
def _is_consistent(mean, white):
    """
    Return whether most points lie on the bone within white noise, and hardly any inside it.

    Points outside may be soft tissue; an error of the model or the tracker affects both sides.
    """
    on, inside = 0, 0
    for k in range(len(mean)):
        on += abs(mean[k]) < CONSISTENT * white
        inside += mean[k] < -CONSISTENT * white
    return on > 0.5 * len(mean) and inside < 0.1 * len(mean)


@kernel
def local_means(e, neighbours, thickness, near, mean):
    """
    Fill ``mean`` (n,) with the mean residual of each point's neighbours, without far points.

    That of a touch, which has no neighbours, is its own residual.
    """
    s, K = neighbours.shape
    for k in range(s, len(e)):
        mean[k] = e[k]
    for k in range(s):
        close = abs(e[k]) < 2.0 * thickness
        near[2 * k] = e[k] if close else 0.0
        near[2 * k + 1] = 1.0 if close else 0.0
    for k in range(s):
        total = count = 0.0
        for j in range(K):
            i = np.uint64(2) * np.uint64(neighbours[k, j])      # unsigned: no check for negatives
            total += near[i]
            count += near[i + np.uint64(1)]
        mean[k] = total / count if count > 0.0 else e[k]


@kernel
def _white_noise(e, mean, K, thickness, floor, difference):
    """Return the noise (SD) from differences to local means, which a wrong pose hardly affects."""
    count = 0
    for k in range(len(e)):
        difference[count] = abs(e[k] - mean[k])
        count += abs(mean[k]) < thickness
    # median absolute deviation; the mean contains 1/K of the point itself
    if count == 0:
        return floor
    return max(1.4826 * median(difference[:count]) / math.sqrt(1.0 - 1.0 / K), floor)


@kernel
def _expectation(e, mean, inlier_ratio, noise, local_sd, thickness, weight):
    """
    Fill ``weight`` with the probability that each point is on the bone.

    Returns the expected number of points on the bone, the mean square of their local means, and the
    number of points that are more likely on the bone than not.
    """
    on_bone = squared = likely = 0.0
    inside, outside = _odds_at_zero(inlier_ratio, local_sd, thickness)
    per_local_sd, per_noise = 1.0 / local_sd, 1.0 / noise
    for k in range(len(e)):
        m = mean[k] * per_local_sd
        r = (e[k] - mean[k]) * per_noise
        odds = ((outside if mean[k] > 0.0 else inside) - 0.5 * m * m
                + min(0.0, OUTLIER_EXCESS - 0.5 * r * r))
        weight[k] = 1.0 / (1.0 + math.exp(-odds)) if odds > -30.0 else 0.0
        on_bone += weight[k]
        squared += weight[k] * mean[k] * mean[k]
        likely += weight[k] > 0.5
    return on_bone, squared / max(on_bone, 1.0), likely


@kernel
def _log_likelihood(mean, K, inlier_ratio, local_sd, thickness):
    """Return the log-likelihood of the local means; as neighbours overlap, each counts 1/K."""
    inside, outside = _odds_at_zero(inlier_ratio, local_sd, thickness)
    likelihood = len(mean) * math.log((1.0 - inlier_ratio) / thickness)
    product = 1.0
    for k in range(len(mean)):
        m = mean[k] / local_sd
        odds = (outside if mean[k] > 0.0 else inside) - 0.5 * m * m
        likelihood += max(odds, 0.0)
        # the logarithm of a product is faster than the sum of logarithms
        product *= ((1.0 + math.exp(-abs(odds)))
                    * (OUTSIDE_SHARE if mean[k] > 0.0 else 1.0 - OUTSIDE_SHARE))
        if k % 128 == 127:
            likelihood += math.log(product)
            product = 1.0
    return (likelihood + math.log(product)) / K


@kernel
def _odds_at_zero(inlier_ratio, local_sd, thickness):
    """Return the log-odds of a local mean near zero, just inside the bone and just outside."""
    odds = math.log(inlier_ratio / (1.0 - inlier_ratio) / (ROOT_2PI * local_sd / thickness))
    return odds - math.log(1.0 - OUTSIDE_SHARE), odds - math.log(OUTSIDE_SHARE)


def weights_with_error(e: Array, neighbours: NDArray[np.int64], noise: float, inlier_ratio: float,
                       error_sd: float) -> tuple[Array, Array]:
    """
    Return weights (n,) and observed information (n,) if the model has an error.

    Without it, a place where the model is off looks like soft tissue, and its points count half.

    Parameters
    ----------
    e : (n,) float, metres
        Residuals.
    neighbours : (n, k) int
        Nearest neighbours of each point.
    noise, error_sd : float, metres
        Standard deviations of the noise of a point and of the error of the model.
    inlier_ratio : float

    """
    n, K = neighbours.shape
    mean, weight, information = np.zeros((3, n))
    local_sd = math.sqrt(error_sd**2 + noise**2 / K)
    local_means(e, neighbours, INTERFERENCE_RANGE, np.zeros(2 * n), mean)
    _expectation(e, mean, inlier_ratio, noise, local_sd, INTERFERENCE_RANGE, weight)
    _observed_information(mean, weight, local_sd, n, np.zeros(0), information)
    return weight, information


def patch_likelihood(e: Array, neighbours: NDArray[np.int64], local_sd: float,
                     touch_sd: Array = NO_TOUCHES) -> float:
    """
    Return the log-likelihood of residuals for a given standard deviation of their local means.

    Parameters
    ----------
    e : (n,) float, metres
        Residuals.
    neighbours : (s, k) int
        Nearest neighbours of each point on a stroke.
    local_sd : float, metres
    touch_sd : (n - s,) float, metres
        Standard deviation of each touch.

    """
    return float(_patch_likelihood(e, neighbours, local_sd, touch_sd**2, INTERFERENCE_RANGE))


@kernel
def _patch_likelihood(e, neighbours, local_sd, variance, thickness):
    s, K = neighbours.shape
    mean = np.zeros(len(e))
    local_means(e, neighbours, thickness, np.zeros(2 * s), mean)
    return (_log_likelihood(mean[:s], K, 0.5, local_sd, thickness)
            + touch_likelihood(e[s:], variance, 0.5, thickness, OUTSIDE_SHARE))
