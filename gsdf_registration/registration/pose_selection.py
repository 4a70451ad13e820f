# SPDX-License-Identifier: Apache-2.0
"""Solve from several start poses and select the best solution and its alternatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import LandmarkFit
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.free_space import NOTHING_BLOCKED, Blocked
from gsdf_registration.registration.landmark_evidence import slide
from gsdf_registration.registration.local_solutions import SAME_MINIMUM, distance_of_poses
from gsdf_registration.solver import (
    Solution,
    allow_for_model_error,
    before,
    nearest_neighbours,
    patch_likelihood,
    refine,
    touch_deviations,
)

# Log-likelihood by which another pose may be less likely at the optimum of its points, and still
# count after all landmarks of the more likely one turn out to be mistakes
IN_REACH = 200.0


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
    decided_by_air : bool, whether they were used to select the pose
    landmarks : of LandmarkFit, those with a standard deviation, at the pose
    """

    solution: Solution
    residuals: Array
    alternatives: list[AlternativePose]
    blocked: Blocked = NOTHING_BLOCKED
    decided_by_air: bool = False
    landmarks: tuple[LandmarkFit, ...] = ()

    @property
    def runner_up_ratio(self) -> float | None:
        """The smallest cost ratio of the alternatives; None without alternatives."""
        return min((other.cost_ratio for other in self.alternatives), default=None)

    def ambiguous(self, min_gap: float) -> list[Array]:
        """Return the alternatives, T_bone_tracker, with a gap below ``min_gap``."""
        return [other.T_bone_tracker for other in self.alternatives if other.gap < min_gap]


def select_pose(solutions: Sequence[Solution], points: Array, field: Field,
                config: Config, evidence: Evidence = Evidence()) -> SelectedPose:
    """
    Return the solution of the highest rank, with the other local minima as alternatives.

    Landmarks may favour another minimum. Each is judged by its own joint optimum with them, because
    it may be far from its place in a direction that the points hardly constrain. The selected
    solution is the optimum of the points alone; it allows for an error of the model.

    Parameters
    ----------
    solutions : sequence of Solution
        One or more, of the same points.
    points : (n, 3) float64, metres, tracker frame
    field : Field
    config : Config
    evidence : Evidence
        What is known of the pose besides the points.

    """
    best = max(solutions, key=lambda solution: solution.rank)
    neighbours = nearest_neighbours(before(best.touches, points), field, best.T_bone_tracker)
    local_sd, touch_sd = _deviations(best, neighbours, 0.01 * field.voxel_size)
    landmarks, apart = evidence.landmarks.measured, distance_of_poses(points)

    def judge(T: Array) -> _JudgedPose:
        # the same measures for all poses: the likelihood of the local means and a robust cost
        e, known = field.sample(rigid.transform(T, points))[0], evidence.log_likelihood(T, field)
        return _JudgedPose(T, patch_likelihood(e, neighbours, local_sd, touch_sd) + known, known,
                           float((e**2 / (e**2 + config.solver.cauchy_scale**2)).sum()))
    candidates = [best, *solutions]
    judged = [judge(solution.T_bone_tracker) for solution in candidates]
    minima, chosen = _distinct(judged, 0, apart), 0
    if len(landmarks):
        sd = np.append(np.full(len(before(best.touches, points)),
                               local_sd * np.sqrt(neighbours.shape[1])), touch_sd)
        candidates = [candidates[k] for k in minima]
        judged, chosen = _joint_optima(
            [judged[k] for k in minima],
            lambda T: judge(slide(T, points, field, sd, landmarks)))
        if chosen:
            best = refine(points, field, candidates[chosen], config.solver)
        minima = _distinct(judged, chosen, apart)
    alternatives = [
        AlternativePose(judged[k].T_bone_tracker, judged[chosen].likelihood - judged[k].likelihood,
                        judged[k].cost / max(judged[chosen].cost, 1e-12)) for k in minima[1:]]
    best = allow_for_model_error(best, points, field, config.model.surface_error)
    residual = field.sample(rigid.transform(best.T_bone_tracker, points))[0]
    return SelectedPose(best, residual, alternatives)


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


def _joint_optima(minima: Sequence[_JudgedPose],
                  joint: Callable[[Array], _JudgedPose]) -> tuple[list[_JudgedPose], int]:
    """
    Return minima at their ``joint`` optimum with the landmarks, and which one is the best.

    Another one than the first is better only if the evidence is for it.
    """
    found = []
    for pose in minima:
        in_reach = pose.likelihood > minima[0].likelihood - IN_REACH
        moved = joint(pose.T_bone_tracker) if in_reach else pose
        found.append(max(pose, moved, key=lambda each: each.likelihood))
    favoured = [k for k, pose in enumerate(found) if pose.evidence >= found[0].evidence]
    return found, max(favoured, key=lambda k: found[k].likelihood)


def _distinct(poses: Sequence[_JudgedPose], first: int,
              apart: Callable[[Array, Array], float]) -> list[int]:
    """Return which poses are distinct minima: the ``first``, then the most likely ones."""
    found = [first]
    for k in np.argsort([pose.likelihood for pose in poses], kind='stable')[::-1].tolist():
        T = poses[k].T_bone_tracker
        if all(apart(T, poses[other].T_bone_tracker) > SAME_MINIMUM for other in found):
            found.append(k)
    return found


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
