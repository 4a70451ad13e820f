# SPDX-License-Identifier: Apache-2.0
"""A look at all points held: what is the pose, what speaks against it, what would help."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from dataclasses import field as item

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.point_filters import filter_isolated
from gsdf_registration.common.result import NextTouch, Reason, Refusal
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.field import Field
from gsdf_registration.live.warm_pose import WarmPose
from gsdf_registration.registration.acceptance import Candidate, describe, rejection_reasons
from gsdf_registration.registration.confidence import assess_at
from gsdf_registration.registration.pipeline import attempt, check_points
from gsdf_registration.registration.pose_selection import SelectedPose
from gsdf_registration.registration.stroke_report import StrokeReport, report
from gsdf_registration.solver import Solution

SEEN = 2    # times the points used that are looked at, or it would take ever longer
Rows = NDArray[np.int64]
# All that may speak against a pose that is shown; of one that was followed for a while, it is for a
# search to say whether it fits the model too badly, for that hangs on which points are used.
LOOSE = Reason.UNDER_CONSTRAINED


@dataclass(frozen=True)
class FullAssessment:
    """
    What was found.

    points : all that were held
    on_strokes : int, how many of them count
    used : int, how many of these the pose was found from
    searched : bool, whether the bone was searched for, not only followed
    rejection_reasons : what `register` would say against the pose, the gravest first
    predicted_tre_m : as of a `RegistrationResult`; empty without a pose
    pose : to be followed from here on; None if there is none
    T_tracker_bone, covariance : (4, 4), (6, 6), of the pose as it was found; None unless it is
        trusted, that is held too loosely at worst
    residuals_m, weights : (n,) float, of the points; empty unless the pose is trusted
    strokes : a report of each; none unless the pose is trusted
    """

    points: Points
    on_strokes: int = 0
    used: int = 0
    searched: bool = False
    rejection_reasons: tuple[Refusal, ...] = ()
    predicted_tre_m: dict[str, float] = item(default_factory=dict)
    pose: WarmPose | None = None
    T_tracker_bone: Array | None = None
    covariance: Array | None = None
    residuals_m: Array = item(default_factory=lambda: np.zeros(0))
    weights: Array = item(default_factory=lambda: np.zeros(0))
    strokes: tuple[StrokeReport, ...] = ()

    @property
    def trusted(self) -> bool:
        """Whether the pose may be shown."""
        return self.T_tracker_bone is not None

    @property
    def rejection_reason(self) -> Refusal | None:
        """The one to speak of, the gravest."""
        return next(iter(self.rejection_reasons), None)

    @property
    def touches(self) -> tuple[NextTouch, ...]:
        """Where to touch next, best first: what is seen is what is spoken of."""
        return () if self.rejection_reason is None else self.rejection_reason.next_touches


def survey(points: Points, field: Field, config: Config, before: Solution | None,
           search_from: float, guess: Array | None, last: tuple[Refusal, ...],
           cancelled: Callable[[], bool]) -> FullAssessment:
    """
    Look at all points.

    Parameters
    ----------
    points : Points
    field : of the bone
    config : Config
    before : Solution, optional
        To follow, unless the bone is searched for.
    search_from : float
        With so many points on strokes, or more, the bone is searched for.
    guess : (4, 4) float, optional
        T_bone_tracker, where it is searched for first.
    last : of Refusal
        What is said while there is nothing to follow.
    cancelled : asked now and then; a true answer ends the work

    Raises
    ------
    Cancelled

    """
    positions = points.positions
    try:
        check_points(positions, field, config.limits)
    except Refusal as refusal:
        return FullAssessment(points, rejection_reasons=(refusal,))
    rows = evenly(np.arange(len(positions)), SEEN * config.live.max_points)
    seen = positions[rows]
    dense = np.flatnonzero(filter_isolated(seen))
    count = len(dense) * len(positions) // len(rows)
    chosen = evenly(dense, config.live.max_points)
    searched = count >= search_from
    if searched:
        found, against = _searched(seen[dense], field, config, guess, cancelled)
        pose = WarmPose(seen[chosen], field, found.choice.solution, config)
        pose.confidence = found.confidence
    elif before is not None:
        pose, found, against = _followed(seen[chosen], field, config, before)
    else:
        return FullAssessment(points, count, rejection_reasons=last)
    tre = found.known.get('predicted_tre_m', {})
    known = FullAssessment(points, count, len(chosen), searched, against, tre, pose)
    may_be_said = (LOOSE,) if searched else (LOOSE, Reason.MODEL_MISMATCH)
    if found.confidence is None or any(no.reason not in may_be_said for no in against):
        # a search may find it elsewhere; what was followed may be off for a moment
        return replace(known, pose=None) if searched else known
    # a point that was thinned out is on the bone if the one next to it is
    weights = np.zeros(len(seen))
    weights[dense] = pose.solution.weights[_last_of(chosen, dense)]
    weights = weights[_last_of(rows, np.arange(len(positions)))]
    residuals = field.sample(rigid.transform(pose.solution.T_bone_tracker, positions))[0]
    return replace(known, T_tracker_bone=pose.T_tracker_bone, covariance=pose.covariance,
                   residuals_m=residuals, weights=weights,
                   strokes=tuple(report(points, residuals, weights)))


def evenly(rows: Rows, most: int) -> Rows:
    """Return ``rows`` (n,), or ``most`` of them, spread evenly from the first to the last."""
    if len(rows) <= most:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)])


def _last_of(some: Rows, rows: Rows) -> Rows:
    """Return the place in ``some``, rising, of the last that does not come after each of rows."""
    return np.asarray(np.searchsorted(some, rows, side='right') - 1)


def _searched(used: Array, field: Field, config: Config, guess: Array | None,
              cancelled: Callable[[], bool]) -> tuple[Candidate, tuple[Refusal, ...]]:
    """Do what `register` does, on one thread: the others have points to take in meanwhile."""
    config = config.replaced({'search.threads': 1})
    every = np.ones(len(used), dtype=bool)
    for start in (None,) if guess is None else (guess, None):
        found = attempt(used, every, start, field, config, cancelled)
        against = tuple(rejection_reasons(found, used, field, config))
        if all(no.reason is LOOSE for no in against):
            break
    return found, against


def _followed(used: Array, field: Field, config: Config,
              before: Solution) -> tuple[WarmPose, Candidate, tuple[Refusal, ...]]:
    """Solve from a pose found before."""
    pose = WarmPose(used, field, before, config)
    pose.confidence = assess_at(pose.solution, used, field, config.solver)
    residuals = field.sample(rigid.transform(pose.solution.T_bone_tracker, used))[0]
    found = describe(SelectedPose(pose.solution, residuals, []), pose.confidence,
                     np.ones(len(used), dtype=bool), field, config)
    return pose, found, tuple(rejection_reasons(found, used, field, config))
