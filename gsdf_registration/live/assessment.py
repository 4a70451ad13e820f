# SPDX-License-Identifier: Apache-2.0
"""The full assessment: the pose from all points, the reasons to reject it, and what would help."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from dataclasses import field as item

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import NextTouch, Reason, Refusal, Zone
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.field import Field
from gsdf_registration.live.warm_pose import WarmPose
from gsdf_registration.registration.acceptance import rejection_reasons
from gsdf_registration.registration.candidate import Candidate, assess_candidate
from gsdf_registration.registration.confidence import assess_at
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.input_checks import check_points, check_selection
from gsdf_registration.registration.pipeline import choose_candidate, find_candidates
from gsdf_registration.registration.point_selection import (
    PointSelection,
    select_points,
    weights_of_all,
)
from gsdf_registration.registration.pose_selection import SelectedPose
from gsdf_registration.registration.stroke_report import StrokeReport, report_strokes
from gsdf_registration.solver import Solution

# A search uses at most this many times `live.max_points` points
SEARCH_FACTOR = 2

# Reasons that do not prevent a pose from being shown. The reason `model_mismatch` depends on which
# points are used, so a pose that is followed is rejected for it only by a search.
TOLERATED_AFTER_SEARCH = {Reason.UNDER_CONSTRAINED}
TOLERATED_WHILE_FOLLOWING = {Reason.UNDER_CONSTRAINED, Reason.MODEL_MISMATCH}


@dataclass(frozen=True)
class FullAssessment:
    """
    The result of a full assessment.

    points : all points
    on_strokes : int, number of them on strokes
    used : int, number of these used for the pose
    searched : bool, whether the bone was searched and not only followed
    rejection_reasons : for which `register` would reject the pose, most severe first
    predicted_tre_m, zone : as in `RegistrationResult`; empty without a pose
    pose : to follow from here on; None if there is none
    T_tracker_bone, covariance : (4, 4), (6, 6), of the pose; None unless it is trusted
    residuals_m, weights : (n,) float, of the points; empty unless the pose is trusted
    stroke_reports : one per stroke; empty unless the pose is trusted

    A pose is trusted if the only reason to reject it, if any, is too few points.
    """

    points: Points
    on_strokes: int = 0
    used: int = 0
    searched: bool = False
    rejection_reasons: tuple[Refusal, ...] = ()
    predicted_tre_m: dict[str, float] = item(default_factory=dict)
    zone: Zone | None = None
    pose: WarmPose | None = None
    T_tracker_bone: Array | None = None
    covariance: Array | None = None
    residuals_m: Array = item(default_factory=lambda: np.zeros(0))
    weights: Array = item(default_factory=lambda: np.zeros(0))
    stroke_reports: tuple[StrokeReport, ...] = ()

    @property
    def trusted(self) -> bool:
        """Whether the pose may be shown."""
        return self.T_tracker_bone is not None

    @property
    def rejection_reason(self) -> Refusal | None:
        """The most severe rejection reason."""
        return next(iter(self.rejection_reasons), None)

    @property
    def next_touches(self) -> tuple[NextTouch, ...]:
        """Where to touch next, best first: the places that the most severe reason names."""
        return () if self.rejection_reason is None else self.rejection_reason.next_touches


def assess_all_points(points: Points,
                      field: Field,
                      config: Config,
                      *,
                      previous: Solution | None = None,
                      search_threshold: float = 0,
                      guess: Array | None = None,
                      evidence: Evidence = Evidence(),
                      previous_reasons: tuple[Refusal, ...] = (),
                      cancelled: Callable[[], bool] = lambda: False) -> FullAssessment:
    """
    Return a full assessment of all points.

    Parameters
    ----------
    points : Points
    field : of the bone
    config : Config
    previous : Solution, optional
        To follow, unless the bone is searched.
    search_threshold : float
        The bone is searched if at least this number of points are on strokes.
    guess : (4, 4) float, optional
        T_bone_tracker; the search starts here.
    evidence : Evidence
        What is known of the pose besides the points.
    previous_reasons : of Refusal
        Result if there is neither a search nor a pose to follow.
    cancelled : callable
        Called repeatedly; if it returns True, the assessment stops.

    Raises
    ------
    Cancelled

    """
    field = field.for_tip(config.probe.tip_radius)
    try:
        check_points(points.positions, config.limits)
        selection = select_points(points.positions, config.collect.mode,
                                  SEARCH_FACTOR * config.live.max_points)
        check_selection(selection, points.positions, field, config.limits)
    except Refusal as refusal:
        return FullAssessment(points, rejection_reasons=(refusal,))
    searched = selection.on_strokes >= search_threshold
    if searched:
        used, candidate, reasons = _search(selection, field, config, guess, evidence, cancelled)
        used = used.thinned(config.live.max_points)
        pose = WarmPose(used.positions, field, candidate.solution, config,
                        evidence.landmarks.measured)
        pose.confidence = candidate.confidence
    elif previous is not None:
        alone = (len(previous.touches) == len(previous.weights)
                 and selection.rests >= config.limits.min_points)
        used = selection.rests_alone() if alone else selection
        used = used.thinned(config.live.max_points)
        pose, candidate, reasons = _follow(used, field, config, previous, evidence)
    else:
        return FullAssessment(points, selection.on_strokes, rejection_reasons=previous_reasons)
    found = FullAssessment(points, selection.on_strokes, len(used.rows), searched, reasons,
                           candidate.predicted_tre_m, candidate.zone, pose)
    tolerated = TOLERATED_AFTER_SEARCH if searched else TOLERATED_WHILE_FOLLOWING
    if candidate.confidence is None or any(each.reason not in tolerated for each in reasons):
        # after a search there is nothing to follow; a followed pose may recover with more points
        return replace(found, pose=None) if searched else found
    residuals = field.sample(rigid.transform(pose.solution.T_bone_tracker, points.positions))[0]
    weights = weights_of_all(points.positions, used.rows, pose.solution.weights, residuals)
    return replace(found, T_tracker_bone=pose.T_tracker_bone, covariance=pose.covariance,
                   residuals_m=residuals, weights=weights,
                   stroke_reports=tuple(report_strokes(points, residuals, weights)))


def _search(selection: PointSelection, field: Field, config: Config, guess: Array | None,
            evidence: Evidence, cancelled: Callable[[], bool]
            ) -> tuple[PointSelection, Candidate, tuple[Refusal, ...]]:
    """Run the pipeline like `register`, on one thread: the other cores receive points."""
    config = config.replaced({'search.threads': 1})
    return choose_candidate(
        find_candidates(selection, field, config, guess, evidence, cancelled=cancelled),
        lambda used, found: tuple(rejection_reasons(found, used.positions, field, config)),
        TOLERATED_AFTER_SEARCH)


def _follow(used: PointSelection, field: Field, config: Config, previous: Solution,
            evidence: Evidence) -> tuple[WarmPose, Candidate, tuple[Refusal, ...]]:
    """Solve from a previous solution and assess the result."""
    points = used.positions
    pose = WarmPose(points, field, replace(previous, touches=used.touches), config,
                    evidence.landmarks.measured)
    if pose.confidence is None:
        pose.confidence = assess_at(pose.solution, points, field, config.probe.tip_error)
    residuals = field.sample(rigid.transform(pose.solution.T_bone_tracker, points))[0]
    selected = SelectedPose(pose.solution, residuals, [], landmarks=pose.landmark_fits)
    candidate = assess_candidate(selected, pose.confidence, points, field, config)
    return pose, candidate, tuple(rejection_reasons(candidate, points, field, config))
