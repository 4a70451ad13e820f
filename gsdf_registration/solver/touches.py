# SPDX-License-Identifier: Apache-2.0
"""
Touches: points that were touched one by one, each the mean of a tip at rest.

The mean residual of neighbours tells bone from interference along a stroke. A touch has no
neighbour that lies on the same surface for sure, so its own residual decides: a mixture of Gaussian
noise and uniform interference for each touch (Jepson and Black 1993). Touches are the last points,
after those on strokes.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import kernel
from gsdf_registration.common.rigid import Array

# Noise of each touch over that of a point on a stroke, or of a typical touch if there is no stroke
NO_TOUCHES: Array = np.zeros(0)
MAX_NOISE = 0.0015      # m, standard deviation of a touch: more than that of any tracker
# Parameters of a pose, which the residuals of a few touches fit partly
PARAMETERS = 6.0
ROOT_2PI = math.sqrt(2.0 * math.pi)


def before(touches: Array, rows: Array) -> Array:
    """Return those ``rows`` (n, ...) that are of points on strokes, which precede ``touches``."""
    return rows[:len(rows) - len(touches)]


def touch_deviations(e: Array, weight: Array, touches: Array, noise: float,
                     model_sd: float) -> Array:
    """
    Return the standard deviation (t,), m, of each touch.

    Parameters
    ----------
    e, weight : (n,) float, residuals, m, and weights of all points
    touches : (t,) float, their relative noise
    noise, model_sd : float, m, of points on strokes: standard deviation of the noise, and of the
        error of the model; without such points the noise is that of the touches

    """
    if len(touches) == len(e):
        noise = touch_noise(e, touches, weight, 0.0)
    return np.sqrt((noise * touches)**2 + model_sd**2)


@kernel
def touch_variances(relative, noise, model_variance, variance):
    """Fill ``variance`` (t,), m^2, of the residuals of touches with ``relative`` (t,) noise."""
    for k in range(len(relative)):
        own = noise * relative[k]
        variance[k] = own * own + model_variance


@kernel
def touch_expectation(e, variance, inlier_ratio, thickness, outside_share, weight):
    """
    Fill ``weight`` (t,) with the probability that each touch is on the bone.

    Returns the expected number of touches on the bone, and the number that are more likely on the
    bone than not.
    """
    on_bone = likely = 0.0
    for k in range(len(e)):
        odds = _odds(e[k], variance[k], inlier_ratio, thickness, outside_share)
        weight[k] = 1.0 / (1.0 + math.exp(-odds)) if odds > -30.0 else 0.0
        on_bone += weight[k]
        likely += weight[k] > 0.5
    return on_bone, likely


@kernel
def touch_noise(e, relative, weight, floor):
    """Return the noise (SD) of a touch of relative noise 1, without bias by the fitted pose."""
    total = squared = 0.0
    for k in range(len(e)):
        r = e[k] / relative[k]
        total += weight[k]
        squared += weight[k] * r * r
    return min(max(math.sqrt(squared / max(total - PARAMETERS, 1.0)), floor), MAX_NOISE)


@kernel
def touch_likelihood(e, variance, inlier_ratio, thickness, outside_share):
    """Return the log-likelihood of the residuals ``e`` (t,)."""
    likelihood = 0.0
    for k in range(len(e)):
        odds = _odds(e[k], variance[k], inlier_ratio, thickness, outside_share)
        share = outside_share if e[k] > 0.0 else 1.0 - outside_share
        likelihood += (math.log(share * (1.0 - inlier_ratio) / thickness)
                       + max(odds, 0.0) + math.log(1.0 + math.exp(-abs(odds))))
    return likelihood


@kernel
def _odds(e, variance, inlier_ratio, thickness, outside_share):
    """Return the log-odds that a touch is on the bone."""
    share = outside_share if e > 0.0 else 1.0 - outside_share
    density = ROOT_2PI * math.sqrt(variance) / thickness
    odds = inlier_ratio / ((1.0 - inlier_ratio) * share * density)
    return math.log(odds) - 0.5 * e * e / variance
