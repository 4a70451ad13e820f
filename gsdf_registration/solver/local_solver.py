# SPDX-License-Identifier: Apache-2.0
"""Estimate the pose from a first guess near it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.result import Iteration
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.solver import gauss_newton
from gsdf_registration.solver.bias_correction import bias_correction
from gsdf_registration.solver.centroid_frame import about_centroid, pose_about
from gsdf_registration.solver.mixture import INTERFERENCE_RANGE, expectation_maximization
from gsdf_registration.solver.model_error import ModelError, find_model_error
from gsdf_registration.solver.neighbourhood import nearest_neighbours
from gsdf_registration.solver.paper import DISCARD_BELOW, HOLD, WEIGHT_TOLERANCE, algorithm_1

START = 0.0015      # m, scatter of the local means at first: a fair guess is so far off
# m, length of the last step: far below the noise of any tracker, far above rounding errors
TOLERANCE = 1e-6
COOLING = 0.85      # by which it falls a round


class Estimates(NamedTuple):
    """
    What the mixture finds out about the points beside the pose.

    noise : float, m, standard deviation of a point along the normal
    scatter : float, m, that of the mean residuals of neighbours
    share : float in (0, 1), of the points that are on the bone
    limit : float, m, that the scatter may not exceed
    """

    noise: float
    scatter: float
    share: float
    limit: float


@dataclass(frozen=True)
class Solution:
    """
    Where a solver ended, and why.

    T_bone_tracker : (4, 4) float, metres
    step : (4, 4) float, metres, what was taken last, a small motion of the bone frame from where
        the iterations of the mixture ended
    weights : (n,) float in [0, 1], how much each point bears
    residuals : (n,) float, metres, signed distance of each point at the pose, less what noise makes
        of it on average if the last step was taken; NaN where it was discarded before
    precision : (n,) float, the mean noise over that along the normal of each point
    jacobian : (n, 6) float, d residual / d [rotation about the centroid of the points,
        translation], bone axes
    curvature : (n,) float, d(w e)/de, less than the weight, or negative, where a point is about to
        be given up
    exact : whether most points fit as well as white noise lets them and hardly any is inside the
        bone
    score : float, log-likelihood (mixture) or sum of the weights (paper)
    settled : bool, whether the end was reached by settling
    termination : str, why it ended, in words
    iterations : int
    estimates : what to go on with from here; None after the published method
    model_error : that was allowed for; None if none was found, or looked for
    history : the steps, on request
    """

    T_bone_tracker: Array
    step: Array
    weights: Array
    residuals: Array
    precision: Array
    jacobian: Array
    curvature: Array
    exact: bool
    score: float
    settled: bool
    termination: str
    iterations: int
    estimates: Estimates | None = None
    model_error: ModelError | None = None
    history: tuple[Iteration, ...] = ()

    @property
    def rank(self) -> tuple[bool, float]:
        """Of two solutions of the same points, the one of higher rank is better."""
        return self.exact, self.score


def solve(points: Array,
          field: Field,
          T_bone_tracker: Array,
          config: SolverConfig,
          history: bool = False,
          neighbours: NDArray[np.int64] | None = None,
          scatter: float = START,
          exact: bool = True) -> Solution:
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
    exact : mixture: whether to look for a pose that most points fit exactly, the others being soft
        tissue or the like; else for one that all fit within the error of the model

    """
    if config.method == 'paper':
        return _paper(points, field, T_bone_tracker, config, history)
    if neighbours is None:
        neighbours = nearest_neighbours(points, field, T_bone_tracker)
    # the noise is estimated at once, and most of what is touched is bone
    limit = 0.5 * config.model_error if exact else config.model_error
    first = Estimates(0.0, scatter, 0.7, limit)
    return _mixture(points, neighbours, field, T_bone_tracker, config, history, first, exact, False)


def refine(points: Array,
           field: Field,
           previous: Solution,
           config: SolverConfig,
           neighbours: NDArray[np.int64] | None = None,
           carry: bool = True) -> Solution:
    """
    Return the local solution from a previous one, as for points that go on coming in.

    It begins with what was estimated there: nothing has to cool down, so a few rounds do. It
    settles where `solve` would from that pose with these neighbours.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame; more or fewer than before
    field : of the bone
    previous : of `solve` or `refine`; off by no more than some of its scatter
    config : settings of the method that it was found by
    neighbours : (n, k) int of the points, if known already
    carry : whether the last step is that of ``previous``, which a few more points hardly change and
        which spares a third of the time; else it is taken anew

    """
    if previous.estimates is None:
        return _paper(points, field, previous.T_bone_tracker, config, False)
    settled = rigid.inverse(previous.step) @ previous.T_bone_tracker
    if neighbours is None:
        neighbours = nearest_neighbours(points, field, settled)
    return _mixture(points, neighbours, field, settled, config, False, previous.estimates,
                    previous.exact, True, previous.step if carry else None)


def allow_for_model_error(solution: Solution, points: Array) -> Solution:
    """
    Return a solution of the mixture, one step further where the model is seen to be off.

    Parameters
    ----------
    solution : of these points; that of the published method is returned as it is
    points : (n, 3) float64, metres, tracker frame

    """
    T, e, J, weight = (solution.T_bone_tracker, solution.residuals, solution.jacobian,
                       solution.weights)
    error = None if solution.estimates is None else find_model_error(
        rigid.transform(T, points), e, J, weight, solution.precision)
    if error is None:
        return solution
    weighted = error.jacobian.T * (weight * solution.precision**2)
    dx = -np.linalg.solve(weighted @ J, weighted @ e)
    R, centre = rigid.rotation_exp(dx[:3]), rigid.transform(T, points.mean(axis=0))
    step = rigid.from_rt(R, centre + dx[3:] - R @ centre)
    return replace(solution, T_bone_tracker=step @ T, step=step @ solution.step,
                   residuals=e + J @ dx, model_error=error)


def _mixture(points: Array,
             neighbours: NDArray[np.int64],
             field: Field,
             T_bone_tracker: Array,
             config: SolverConfig,
             history: bool,
             estimates: Estimates,
             exact: bool,
             strict: bool,
             step: Array | None = None) -> Solution:
    """Return the solution of `expectation_maximization`, with that last ``step`` or its own."""
    centred, centre, R, t = _about_centroid(points, T_bone_tracker)
    weight, curvature, e = np.zeros((3, len(points)))
    J = np.zeros((len(points), 6))
    steps, found = gauss_newton.empty_history(config.max_iterations), np.array(estimates)
    ended, rounds, likelihood, fits = expectation_maximization(
        field.arrays, centred, R, t, neighbours, weight, curvature, e, J, steps, found, strict,
        exact, COOLING, INTERFERENCE_RANGE, TOLERANCE)
    settled, precision = _pose(centre, R, t), np.ones(len(points))
    if step is None:
        if ended != gauss_newton.SINGULAR:
            bias_correction(field.arrays, centred, R, t, weight, found[0], e, J, precision)
        step = _pose(centre, R, t) @ rigid.inverse(settled)
    return _solution(step @ settled, step, weight, e, precision, J, curvature, fits, likelihood,
                     ended, steps[:rounds], history, Estimates(*found.tolist()))


def _paper(points: Array, field: Field, T_bone_tracker: Array, config: SolverConfig,
           history: bool) -> Solution:
    """Return the solution of `algorithm_1`."""
    centred, centre, R, t = _about_centroid(points, T_bone_tracker)
    keep, weight = np.ones(len(points), dtype=np.bool_), np.zeros(len(points))
    e, J = np.zeros(len(points)), np.zeros((len(points), 6))
    steps = gauss_newton.empty_history(config.max_iterations)
    ended, rounds = algorithm_1(field.arrays, centred, R, t, keep, weight, e, J, steps,
                                config.cauchy_scale, DISCARD_BELOW, WEIGHT_TOLERANCE, HOLD)
    e[~keep] = np.nan
    # d(w e)/de of the Cauchy weight
    curvature = np.where(keep, weight * (2.0 * weight - 1.0), 0.0)
    return _solution(_pose(centre, R, t), np.eye(4), weight, e, np.ones(len(points)), J, curvature,
                     False, float(weight.sum()), ended, steps[:rounds], history)


def _about_centroid(points: Array, T_bone_tracker: Array) -> tuple[Array, Array, Array, Array]:
    """Return centred points, their centre, and its pose, rotation and place, to be changed."""
    centred, centre, R, t = np.empty(points.shape), np.empty(3), np.empty((3, 3)), np.empty(3)
    about_centroid(points, T_bone_tracker, centred, centre, R, t)
    return centred, centre, R, t


def _pose(centre: Array, R: Array, t: Array) -> Array:
    """Return the pose (4, 4) of the points from that of their centre."""
    T = np.empty((4, 4))
    pose_about(centre, R, t, T)
    return T


def _solution(T: Array, step: Array, weight: Array, e: Array, precision: Array, J: Array,
              curvature: Array, exact: bool, score: float, ended: int, steps: Array,
              history: bool, estimates: Estimates | None = None) -> Solution:
    return Solution(
        T, step, weight, e, precision, J, curvature, exact, score,
        ended == gauss_newton.SETTLED, gauss_newton.TERMINATION[ended], len(steps), estimates, None,
        tuple(
            Iteration(cost, turn, shift, int(used))
            for cost, turn, shift, used in steps.tolist()) if history else ())
