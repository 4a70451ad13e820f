# SPDX-License-Identifier: Apache-2.0
"""Solve from several start poses and select the best solution and its alternatives."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, SolverConfig
from gsdf_registration.common.result import INLIER_WEIGHT, Cancelled, LandmarkFit
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.free_space import NOTHING_BLOCKED, Blocked, blocked
from gsdf_registration.registration.landmark_evidence import slide
from gsdf_registration.search.consensus import POSE_ERROR, consensus
from gsdf_registration.solver import (
    NO_TOUCHES,
    Solution,
    allow_for_model_error,
    before,
    nearest_neighbours,
    patch_likelihood,
    refine,
    solve,
    touch_deviations,
)

# m: solutions that place the points less than this apart (RMS) are the same local minimum
SAME_MINIMUM = 0.0015
# Log-likelihood by which another pose may be less likely at the optimum of its points, and still
# count after all landmarks of the more likely one turn out to be mistakes
IN_REACH = 200.0
CONSENSUS_ROUNDS = 4        # at most; a round that finds no better solution is the last
# Poses of a round that are solved: the best one may rank low before it is solved
CONSENSUS_POSES = 48
# Share of the points: no other pose can fit better than one that explains this many
MOSTLY_EXPLAINED = 0.9
EXPLAINED_SD = 3.0          # standard deviations of the mean of an explained neighbourhood


class AlternativePose(NamedTuple):
    """
    Another local minimum.

    T_bone_tracker : (4, 4) float, metres
    gap : float, log-likelihood of the selected pose less that of this one
    cost_ratio : float, Geman-McClure cost of this pose over that of the selected one
    """

    T_bone_tracker: Array
    gap: float
    cost_ratio: float


@dataclass(frozen=True)
class SelectedPose:
    """
    The best solution and its alternatives.

    solution : Solution
    residuals : (n,) float, metres, of all points used, at the pose
    alternatives : of AlternativePose, most likely first
    blocked : Blocked, the places in the air that are inside the bone
    landmarks : of LandmarkFit, those with a standard deviation, at the pose
    """

    solution: Solution
    residuals: Array
    alternatives: list[AlternativePose]
    blocked: Blocked = NOTHING_BLOCKED
    landmarks: tuple[LandmarkFit, ...] = ()

    @property
    def runner_up_ratio(self) -> float | None:
        """The smallest cost ratio of the alternatives; None without alternatives."""
        return min((other.cost_ratio for other in self.alternatives), default=None)

    def ambiguous(self, min_gap: float) -> list[Array]:
        """Return the alternatives, T_bone_tracker, with a gap below ``min_gap``."""
        return [other.T_bone_tracker for other in self.alternatives if other.gap < min_gap]


def select_pose(solutions: Sequence[Solution], points: Array, field: Field,
                config: SolverConfig, evidence: Evidence = Evidence()) -> SelectedPose:
    """
    Return the solution of the highest rank, with the other local minima as alternatives.

    Landmarks may favour another minimum. Each is judged by its own joint optimum with them, because
    it may be far from its place in a direction that the points hardly constrain. The selected
    solution is the optimum of the points alone; it allows for an error of the model, if one is
    found.

    Parameters
    ----------
    solutions : sequence of Solution
        One or more, of the same points.
    points : (n, 3) float64, metres, tracker frame
    field : Field
    config : SolverConfig
    evidence : Evidence
        What is known of the pose beside the points.

    """
    best = max(solutions, key=lambda solution: solution.rank)
    neighbours = nearest_neighbours(before(best.touches, points), field, best.T_bone_tracker)
    local_sd, touch_sd = _deviations(best, neighbours, 0.01 * field.voxel_size)
    landmarks, apart = evidence.landmarks.measured, _distance_of_poses(points)

    def judge(T: Array) -> _JudgedPose:
        # the same measures for all poses: the likelihood of the local means and a robust cost
        e, known = field.sample(rigid.transform(T, points))[0], evidence.log_likelihood(T, field)
        return _JudgedPose(T, patch_likelihood(e, neighbours, local_sd, touch_sd) + known, known,
                           float((e**2 / (e**2 + config.cauchy_scale**2)).sum()))
    candidates = [best, *solutions]
    judged = [judge(solution.T_bone_tracker) for solution in candidates]
    minima, chosen = _distinct(judged, 0, apart), 0
    if len(landmarks):
        sd = np.append(np.full(len(before(best.touches, points)),
                               local_sd * np.sqrt(neighbours.shape[1])), touch_sd)
        for k in minima:
            if judged[k].likelihood > judged[0].likelihood - IN_REACH:
                joint = judge(slide(judged[k].T_bone_tracker, points, field, sd, landmarks))
                judged[k] = max(judged[k], joint, key=lambda pose: pose.likelihood)
        chosen = max((k for k in minima if judged[k].evidence >= judged[0].evidence),
                     key=lambda k: judged[k].likelihood)
        if chosen:
            best = refine(points, field, candidates[chosen], config)
        judged = [judged[k] for k in minima]
        chosen = minima.index(chosen)
        minima = _distinct(judged, chosen, apart)
    alternatives = [
        AlternativePose(judged[k].T_bone_tracker, judged[chosen].likelihood - judged[k].likelihood,
                        judged[k].cost / max(judged[chosen].cost, 1e-12)) for k in minima[1:]]
    best = allow_for_model_error(best, points)
    residual = field.sample(rigid.transform(best.T_bone_tracker, points))[0]
    return SelectedPose(best, residual, alternatives,
                        blocked(evidence.air, best.T_bone_tracker, field))


class _JudgedPose(NamedTuple):
    """
    A pose, judged by the same measures as others.

    T_bone_tracker : (4, 4) float, metres
    likelihood : float, log-likelihood of points and evidence
    evidence : float, the part of the evidence
    cost : float, Geman-McClure cost
    """

    T_bone_tracker: Array
    likelihood: float
    evidence: float
    cost: float


def _distinct(poses: Sequence[_JudgedPose], first: int,
              apart: Callable[[Array, Array], float]) -> list[int]:
    """Return which poses are distinct minima: the ``first``, then the most likely ones."""
    found = [first]
    for k in np.argsort([pose.likelihood for pose in poses], kind='stable')[::-1].tolist():
        T = poses[k].T_bone_tracker
        if all(apart(T, poses[other].T_bone_tracker) > SAME_MINIMUM for other in found):
            found.append(k)
    return found


def _distance_of_poses(points: Array) -> Callable[[Array, Array], float]:
    """
    Return the distance between the images of ``points`` (n, 3) under two motions, m (RMS).

    It follows from the moments of the points, so it takes a few microseconds for any n.
    """
    centroid = points.mean(axis=0)
    arms = points - centroid
    moments = (arms[:, :, None] * arms[:, None, :]).mean(axis=0)

    def distance(T_a: Array, T_b: Array) -> float:
        D = T_a - T_b
        shift = D[:3, :3] @ centroid + D[:3, 3]
        return float(np.sqrt(shift @ shift + ((D[:3, :3] @ moments) * D[:3, :3]).sum()))
    return distance


def _deviations(solution: Solution, neighbours: NDArray[np.int64],
                floor: float) -> tuple[float, Array]:
    """
    Return the standard deviations of the local means of the residuals, and of each touch (t,), m.

    None is below ``floor``. Only white noise counts if the solution is consistent.
    """
    e, w, touches = np.nan_to_num(solution.residuals), solution.weights, solution.touches
    if not len(neighbours):
        return floor, np.maximum(touch_deviations(e, w, touches, 0.0, 0.0), floor)
    on, own, count = before(touches, e), before(touches, w), neighbours.shape[1]
    mean = on[neighbours].mean(axis=1)
    noise = 1.4826 * float(np.median(np.abs(on - mean)))
    local_sd = white = max(noise / float(np.sqrt(count)), floor)
    if not solution.consistent:
        local_sd = max(white, float(np.sqrt((own * mean**2).sum() / max(own.sum(), 1e-9))))
    model_sd = float(np.sqrt(local_sd**2 - white**2))
    return local_sd, touch_deviations(e, w, touches, float(np.sqrt(count)) * white, model_sd)


def solve_all(points: Array,
              field: Field,
              starts: Sequence[Array],
              config: Config,
              history: bool = False,
              cancelled: Callable[[], bool] | None = None,
              touches: Array = NO_TOUCHES,
              evidence: Evidence = Evidence()) -> list[Solution]:
    """
    Return the local solution from each start, and more if the best one does not explain the points.

    Only the first solution of the highest rank has values per point.

    Soft tissue may bias the best solution: then also solve from poses near it that fit a few
    patches. If no solution is consistent, also solve without annealing to the noise, which allows
    for errors of the model and the tracker.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : Field
    starts : sequence of (4, 4) float, T_bone_tracker, metres
    config : Config
    history : bool
        Whether the solutions contain every iteration.
    cancelled : callable, optional
        Called before each solve; if it returns True, `Cancelled` is raised.
    touches : (t,) float
        Relative noise of the last t points, which are touches.
    evidence : Evidence
        What is known of the pose beside the points; its log-likelihood is part of each score.

    Raises
    ------
    Cancelled

    """
    def solve_from(start: Array, **options: Any) -> Solution:
        if cancelled is not None and cancelled():
            raise Cancelled
        found = solve(points, field, start, config.solver, history, touches=touches, **options)
        return replace(
            found, score=found.score + evidence.log_likelihood(found.T_bone_tracker, field))

    solutions = _Solutions()
    with ThreadPoolExecutor(config.search.threads or os.cpu_count() or 1) as pool:
        solutions.add(pool.map(solve_from, starts))
        if config.solver.method == 'paper':
            return solutions.all
        for _ in range(CONSENSUS_ROUNDS):
            best = solutions.best
            neighbours = nearest_neighbours(before(touches, points), field, best.T_bone_tracker)
            if _explained_share(best, neighbours) > MOSTLY_EXPLAINED:
                break
            poses = consensus(points, field, best.T_bone_tracker, neighbours, CONSENSUS_POSES)
            highest = solutions.add(
                pool.map(partial(solve_from, neighbours=neighbours, local_sd=POSE_ERROR), poses))
            if highest < (best.consistent, best.score + 1.0):
                break
        if not solutions.best.consistent:
            solutions.add(pool.map(partial(solve_from, anneal_to_noise=False), starts))
    return solutions.all


class _Solutions:
    """
    Solutions of the same points.

    Only the best one keeps its values per point: of many points, hundreds of solutions would take
    hundreds of megabytes.
    """

    def __init__(self) -> None:
        self.all: list[Solution] = []
        self._best = 0

    @property
    def best(self) -> Solution:
        """The first of the solutions of the highest rank."""
        return self.all[self._best]

    def add(self, found: Iterable[Solution]) -> tuple[bool, float]:
        """Add one or more solutions; return the highest rank among them."""
        highest = (False, -np.inf)
        for solution in found:
            highest = max(highest, solution.rank)
            if self.all and not solution.rank > self.best.rank:
                self.all.append(_without_points(solution))
                continue
            if self.all:
                self.all[self._best] = _without_points(self.best)
            self._best = len(self.all)
            self.all.append(solution)
        return highest


def _without_points(solution: Solution) -> Solution:
    """Return the solution without its values per point."""
    none = np.zeros(0)
    return replace(solution, weights=none, residuals=none, precision=none, curvature=none,
                   jacobian=np.zeros((0, 6)))


def _explained_share(solution: Solution, neighbours: NDArray[np.int64]) -> float:
    """Return the share of the points whose local mean is within that of white noise."""
    if not len(neighbours):
        return float((solution.weights > INLIER_WEIGHT).mean())
    e = before(solution.touches, solution.residuals)
    mean = e[neighbours].mean(axis=1)
    noise = 1.4826 * np.median(np.abs(e - mean))
    limit = EXPLAINED_SD * noise / np.sqrt(neighbours.shape[1])
    return float((np.abs(mean) < limit).mean())
