# SPDX-License-Identifier: Apache-2.0
"""Estimate the pose from a first guess near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration import rigid
from gsdf_registration.config import SolverConfig
from gsdf_registration.field import Field
from gsdf_registration.result import Iteration
from gsdf_registration.rigid import Array
from gsdf_registration.solver import gauss_newton
from gsdf_registration.solver.mixture import expectation_maximization
from gsdf_registration.solver.paper import algorithm_1

START = 0.0015      # m, scatter of the local means at first: a fair guess is so far off
COOLING = 0.85      # by which it falls a round
FLATTENED = 0.75    # share of its distance to the bone that a point is moved to find neighbours


@dataclass(frozen=True)
class Solution:
    """
    Where a solver ended, and why.

    T_bone_tracker : (4, 4) float, metres
    weights : (n,) float in [0, 1], how much each point bears
    residuals : (n,) float, metres, signed distance of each point at the pose; NaN where it was
        discarded before
    jacobian : (n, 6) float, d residual / d [rotation about the centroid of the points,
        translation], bone axes
    curvature : (n,) float, d(w e)/de, less than the weight where a point is about to be given up
    score : float, log-likelihood (mixture) or sum of the weights (paper): of two solutions of the
        same points, the higher is better
    settled : bool, whether the end was reached by settling
    termination : str, why it ended, in words
    iterations : int
    history : the steps, on request
    """

    T_bone_tracker: Array
    weights: Array
    residuals: Array
    jacobian: Array
    curvature: Array
    score: float
    settled: bool
    termination: str
    iterations: int
    history: tuple[Iteration, ...] = ()


def solve(points: Array,
          field: Field,
          T_bone_tracker: Array,
          config: SolverConfig,
          history: bool = False,
          neighbours: NDArray[np.int64] | None = None,
          scatter: float = START) -> Solution:
    """
    Return the local solution from a first guess.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : of the bone
    T_bone_tracker : (4, 4) float, first guess
    config : method and its settings
    history : whether to return every step
    neighbours : (n, k) int of the points, if known already
    scatter : float, metres, mixture: how far the first guess may be off

    """
    if config.method == 'paper':
        return _paper(points, field, T_bone_tracker, config, history)
    if neighbours is None:
        neighbours = nearest_neighbours(points, field, T_bone_tracker, config.neighbours)
    return _mixture(points, neighbours, field, T_bone_tracker, config, history, scatter)


def nearest_neighbours(points: Array, field: Field, T_bone_tracker: Array,
                       count: int) -> NDArray[np.int64]:
    """
    Return indices (n, count) of the points nearest to each of ``points`` (n, 3), itself first.

    Nearest along the bone: most of a point's distance to it is taken away first, or points would
    be neighbours for having the same noise, and its mean over them no longer small.
    """
    placed = rigid.transform(T_bone_tracker, points)
    distance, gradient = field.sample(placed)
    flat = placed - FLATTENED * distance[:, None] * gradient
    nearest = cKDTree(flat).query(flat, k=min(count, len(points)))[1]
    return np.ascontiguousarray(nearest.reshape(len(points), -1), dtype=np.int64)


def _mixture(points: Array,
             neighbours: NDArray[np.int64],
             field: Field,
             T_bone_tracker: Array,
             config: SolverConfig,
             history: bool,
             scatter: float) -> Solution:
    """Return the solution of `expectation_maximization`."""
    centred, R, t = _about_centroid(points, T_bone_tracker)
    weight, e, J = np.zeros(len(points)), np.zeros(len(points)), np.zeros((len(points), 6))
    steps = gauss_newton.empty_history(config.max_iterations)
    ended, rounds, likelihood = expectation_maximization(
        field.arrays, centred, R, t, neighbours, weight, e, J, steps, scatter, COOLING,
        config.reach, config.model_error, config.tolerance)
    return _solution(points, R, t, weight, e, J, weight, likelihood, ended, steps[:rounds],
                     history)


def _paper(points: Array, field: Field, T_bone_tracker: Array, config: SolverConfig,
           history: bool) -> Solution:
    """Return the solution of `algorithm_1`."""
    centred, R, t = _about_centroid(points, T_bone_tracker)
    keep, weight = np.ones(len(points), dtype=np.bool_), np.zeros(len(points))
    e, J = np.zeros(len(points)), np.zeros((len(points), 6))
    steps = gauss_newton.empty_history(config.max_iterations)
    ended, rounds = algorithm_1(field.arrays, centred, R, t, keep, weight, e, J, steps,
                                config.cauchy_scale, config.discard_below, config.weight_tolerance,
                                config.hold)
    e[~keep] = np.nan
    # d(w e)/de of the Cauchy weight
    curvature = np.where(keep, weight * (2.0 * weight - 1.0), 0.0)
    return _solution(points, R, t, weight, e, J, curvature, float(weight.sum()), ended,
                     steps[:rounds], history)


def _about_centroid(points: Array, T_bone_tracker: Array) -> tuple[Array, Array, Array]:
    """Return centred points, rotation and centroid in the bone frame, to be changed in place."""
    centre = points.mean(axis=0)
    return (np.ascontiguousarray(points - centre), np.array(T_bone_tracker[:3, :3]),
            rigid.transform(T_bone_tracker, centre))


def _solution(points: Array, R: Array, t: Array, weight: Array, e: Array, J: Array,
              curvature: Array, score: float, ended: int, steps: Array,
              history: bool) -> Solution:
    T = rigid.orthonormalized(rigid.from_rt(R, t - R @ points.mean(axis=0)))
    return Solution(
        T, weight, e, J, curvature, score, ended == gauss_newton.SETTLED,
        gauss_newton.TERMINATION[ended], len(steps),
        tuple(
            Iteration(cost, turn, shift, int(used))
            for cost, turn, shift, used in steps.tolist()) if history else ())
