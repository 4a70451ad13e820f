# SPDX-License-Identifier: Apache-2.0
"""Estimate the pose from an initial pose near it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.result import Iteration
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.solver import gauss_newton
from gsdf_registration.solver.bias_correction import bias_correction, unbiased_rows
from gsdf_registration.solver.centroid_frame import from_centroid_frame, to_centroid_frame
from gsdf_registration.solver.mixture import (
    INTERFERENCE_RANGE,
    expectation_maximization,
    weights_with_error,
)
from gsdf_registration.solver.model_error import (
    FOUND,
    Allowance,
    ErrorVariances,
    error_variances,
)
from gsdf_registration.solver.neighbourhood import nearest_neighbours
from gsdf_registration.solver.paper import (
    DISCARD_BELOW,
    HOLD,
    WEIGHT_TOLERANCE,
    algorithm_1,
)
from gsdf_registration.solver.solution import Estimates, Solution
from gsdf_registration.solver.touches import NO_TOUCHES, before

INITIAL_LOCAL_SD = 0.0015   # m, of the local means at the initial pose, which may be this far off
INITIAL_INLIER_RATIO = 0.7  # most of what is touched is bone
ANNEALING_FACTOR = 0.85     # by which the standard deviation of the local means falls per iteration
# An error of the model moves the pose by up to a millimetre: the surface is linearized again
MODEL_ERROR_STEPS = 3
MAX_LOCAL_SD = 0.0006   # m, of the local means, by errors of model and tracker
TOLERANCE = 1e-6    # m, of the last step: far below the noise of any tracker, far above rounding


def solve(points: Array,
          field: Field,
          T_bone_tracker: Array,
          config: SolverConfig,
          history: bool = False,
          neighbours: NDArray[np.int64] | None = None,
          local_sd: float = INITIAL_LOCAL_SD,
          anneal_to_noise: bool = True,
          touches: Array = NO_TOUCHES) -> Solution:
    """
    Return the local solution from an initial pose.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
        On strokes first, then touches.
    field : of the bone
    T_bone_tracker : (4, 4) float, initial pose
    config : SolverConfig
    history : whether to return every iteration
    neighbours : (n - t, k) int of the points on strokes, if known
    local_sd : float, metres
        Mixture: how far the initial pose may be off.
    anneal_to_noise : bool
        Mixture: whether to anneal down to white noise, so that most points fit exactly and the
        others are interference such as soft tissue; if false, only down to the model error, within
        which all points may fit.
    touches : (t,) float
        Relative noise of the touches, see `gsdf_registration.solver.touches`.

    """
    if config.method == 'paper':
        return _paper(points, touches, field, T_bone_tracker, config, history)
    if neighbours is None:
        neighbours = nearest_neighbours(before(touches, points), field, T_bone_tracker)
    limit = 0.5 * MAX_LOCAL_SD if anneal_to_noise else MAX_LOCAL_SD
    # the noise is estimated in the first iteration
    initial = Estimates(0.0, local_sd, INITIAL_INLIER_RATIO, limit)
    return _mixture(points, neighbours, touches, field, T_bone_tracker, config, history, initial,
                    anneal_to_noise, False)


def refine(points: Array,
           field: Field,
           previous: Solution,
           config: SolverConfig,
           neighbours: NDArray[np.int64] | None = None,
           reuse_correction: bool = True) -> Solution:
    """
    Return the local solution, warm-started from a previous one.

    It starts from the estimates of the previous solution and needs no annealing, so a few
    iterations suffice. It converges where `solve` would from that pose with these neighbours.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
        More or fewer on strokes than before, but the same touches.
    field : of the bone
    previous : of `solve` or `refine`, with an error of about its ``local_sd`` at most
    config : settings of the method that found it
    neighbours : as in `solve`
    reuse_correction : bool
        Whether to apply the correction of ``previous``, which a few more points hardly change and
        which saves a third of the time, instead of computing it again.

    """
    if previous.estimates is None:
        return _paper(points, previous.touches, field, previous.T_bone_tracker, config, False)
    touches = previous.touches
    uncorrected = rigid.inverse(previous.correction) @ previous.T_bone_tracker
    if neighbours is None:
        neighbours = nearest_neighbours(before(touches, points), field, uncorrected)
    return _mixture(points, neighbours, touches, field, uncorrected, config, False,
                    previous.estimates, previous.consistent, True,
                    previous.correction if reuse_correction else None)


def allow_for_model_error(solution: Solution, points: Array, field: Field,
                          surface_error: float) -> Solution:
    """
    Return a solution of the mixture that allows for an error of the model.

    Parameters
    ----------
    solution : of these points; a solution of the published method is returned unchanged
    points : (n, 3) float64, metres, tracker frame
    field : of the bone
    surface_error : float, m
        Expected standard deviation of the error; 0: none, the solution is returned unchanged.

    """
    estimates = solution.estimates
    if estimates is None or not surface_error:
        return solution
    weight, precision, curvature = solution.weights, solution.precision, solution.curvature
    e, J = solution.residuals.copy(), solution.jacobian.copy()
    x = rigid.transform(solution.T_bone_tracker, points)
    centred, centroid, R, t = _to_centroid_frame(points, solution.T_bone_tracker)
    try:
        sizes = error_variances(x, e, J, weight, precision, surface_error)
        if sizes.found > FOUND:
            weight, curvature = _weights_with_error(solution, points, field, sizes)
            sizes = error_variances(x, e, J, weight, precision, surface_error)
        allowance = Allowance(sizes, x, e, J, weight, precision, estimates.noise)
        for step in range(MODEL_ERROR_STEPS):
            if step:
                unbiased_rows(field.arrays, centred, R, t, weight, estimates.noise, e, J, precision)
            error = allowance.error(e, J)
            gauss_newton.update(R, t, error.step)
    except np.linalg.LinAlgError:
        return solution     # too few points, or they do not constrain the pose
    T = _pose(centroid, R, t)
    return replace(solution, T_bone_tracker=T, weights=weight, residuals=e + J @ error.step,
                   jacobian=J, curvature=curvature,
                   correction=T @ rigid.inverse(solution.T_bone_tracker) @ solution.correction,
                   model_error=error._replace(residuals=solution.residuals))


def _weights_with_error(solution: Solution, points: Array, field: Field,
                        sizes: ErrorVariances) -> tuple[Array, Array]:
    """Return weights and observed information of all points; those of touches stay."""
    strokes, estimates = len(points) - len(solution.touches), solution.estimates
    assert estimates is not None
    neighbours = nearest_neighbours(before(solution.touches, points), field,
                                    solution.T_bone_tracker)
    found = weights_with_error(solution.residuals[:strokes], neighbours, estimates.noise,
                               estimates.inlier_ratio, float(np.sqrt(sizes.local.sum())))
    weight, curvature = (np.concatenate([new, old[strokes:]]) for new, old in zip(
        found, (solution.weights, solution.curvature)))
    return weight, curvature


def _mixture(points: Array,
             neighbours: NDArray[np.int64],
             touches: Array,
             field: Field,
             T_bone_tracker: Array,
             config: SolverConfig,
             history: bool,
             estimates: Estimates,
             anneal_to_noise: bool,
             annealed: bool,
             correction: Array | None = None) -> Solution:
    """Return the solution of `expectation_maximization`, with the given or its own correction."""
    centred, centroid, R, t = _to_centroid_frame(points, T_bone_tracker)
    weight, curvature, e = np.zeros((3, len(points)))
    J, precision = np.zeros((len(points), 6)), np.ones(len(points))
    steps, found = gauss_newton.empty_history(config.max_iterations), np.array(estimates)
    ended, iterations, likelihood, consistent = expectation_maximization(
        field.arrays, centred, R, t, neighbours, touches, weight, curvature, e, J, precision, steps,
        found, annealed, anneal_to_noise, ANNEALING_FACTOR, INTERFERENCE_RANGE, TOLERANCE)
    uncorrected = _pose(centroid, R, t)
    if correction is None:
        if ended != gauss_newton.SINGULAR:
            bias_correction(field.arrays, centred, R, t, weight, found[0], e, J, precision,
                            neighbours, INTERFERENCE_RANGE)
        correction = _pose(centroid, R, t) @ rigid.inverse(uncorrected)
    return _solution(correction @ uncorrected, correction, weight, e, precision, J, curvature,
                     consistent, likelihood, ended, steps[:iterations], history, touches,
                     Estimates(*found.tolist()))


def _paper(points: Array, touches: Array, field: Field, T_bone_tracker: Array,
           config: SolverConfig, history: bool) -> Solution:
    """Return the solution of `algorithm_1`."""
    centred, centroid, R, t = _to_centroid_frame(points, T_bone_tracker)
    keep, weight = np.ones(len(points), dtype=np.bool_), np.zeros(len(points))
    e, J = np.zeros(len(points)), np.zeros((len(points), 6))
    steps = gauss_newton.empty_history(config.max_iterations)
    ended, iterations = algorithm_1(field.arrays, centred, R, t, keep, weight, e, J, steps,
                                    config.cauchy_scale, DISCARD_BELOW, WEIGHT_TOLERANCE, HOLD)
    e[~keep] = np.nan
    # d(w e)/de of the Cauchy weight
    curvature = np.where(keep, weight * (2.0 * weight - 1.0), 0.0)
    return _solution(_pose(centroid, R, t), np.eye(4), weight, e, np.ones(len(points)), J,
                     curvature, False, float(weight.sum()), ended, steps[:iterations], history,
                     touches)


def _to_centroid_frame(points: Array, T_bone_tracker: Array) -> tuple[Array, Array, Array, Array]:
    """Return centred points, their centroid, and their pose (R, t), which the solver updates."""
    centred, centroid, R, t = np.empty(points.shape), np.empty(3), np.empty((3, 3)), np.empty(3)
    to_centroid_frame(points, T_bone_tracker, centred, centroid, R, t)
    return centred, centroid, R, t


def _pose(centroid: Array, R: Array, t: Array) -> Array:
    """Return the pose (4, 4) of the points from the pose of the centred points."""
    T = np.empty((4, 4))
    from_centroid_frame(centroid, R, t, T)
    return T


def _solution(T: Array, correction: Array, weight: Array, e: Array, precision: Array, J: Array,
              curvature: Array, consistent: bool, score: float, ended: int, steps: Array,
              history: bool, touches: Array, estimates: Estimates | None = None) -> Solution:
    return Solution(
        T, correction, weight, e, precision, J, curvature, consistent, score,
        ended == gauss_newton.CONVERGED, gauss_newton.TERMINATION[ended], len(steps), touches,
        estimates, None, tuple(
            Iteration(cost, turn, shift, int(used))
            for cost, turn, shift, used in steps.tolist()) if history else ())
