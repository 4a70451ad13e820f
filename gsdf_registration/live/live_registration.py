# SPDX-License-Identifier: Apache-2.0
"""
A registration that is updated while points arrive.

It works at two rates. `LiveRegistration.follow` adds new points by a warm-started solve, in about a
millisecond. A full assessment considers all points and sometimes searches the whole bone; it takes
up to a second and therefore runs on another thread. A pose that fails the assessment is not
returned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from dataclasses import field as item
from typing import NamedTuple

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.formatting import format_error
from gsdf_registration.common.result import Reason
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points, without_tools
from gsdf_registration.field import Field
from gsdf_registration.live.assessment import FullAssessment, assess_all_points
from gsdf_registration.live.warm_pose import WarmPose
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.stroke_report import StrokeReport
from gsdf_registration.solver import Solution

# Search again once the number of points on strokes has grown by this factor since the last search:
# with an accepted pose, without one, and when the rejection reasons have changed.
GROWTH, GROWTH_WITHOUT_POSE, GROWTH_AFTER_CHANGE = 2.0, 1.2, 1.1

AssessmentJob = Callable[[Callable[[], bool]], FullAssessment]  # argument: `cancelled`


class LivePose(NamedTuple):
    """
    The current estimate.

    T_tracker_bone : (4, 4) float, metres
    covariance : (6, 6) float, REP-103 order, m and rad
    stamp : float, s, of the newest point used
    """

    T_tracker_bone: Array
    covariance: Array
    stamp: float


@dataclass(frozen=True)
class LiveStatus:
    """
    The state of the live registration.

    ready : whether the points suffice for a registration
    message : one sentence: what is missing and what to do; empty if there is nothing to report
    reason : of what is missing
    touch_next : where a touch would help, a sentence; empty if nowhere
    used : number of points used for the pose
    predicted_tre_m : as in `RegistrationResult`; empty without a pose
    stroke_reports : one per stroke; empty unless the pose is trusted
    """

    ready: bool = False
    message: str = ''
    reason: Reason | None = None
    touch_next: str = ''
    used: int = 0
    predicted_tre_m: dict[str, float] = item(default_factory=dict)
    stroke_reports: tuple[StrokeReport, ...] = ()


class LiveRegistration:
    """
    Follows the points of a session.

    Not thread-safe, but an assessment job may run on another thread. The output depends only on
    the order of the calls and not on time.

    Parameters
    ----------
    field : of the bone; that for the tip is made from it
    config : Config

    """

    def __init__(self, field: Field, config: Config) -> None:
        self.revision = -1      # of the points followed, as counted by their source
        self.assessment: FullAssessment | None = None   # the last one
        self.ready = False      # whether a search has found a pose that `register` would accept
        self._field = field.for_tip(config.probe.tip_radius)
        self._config = config
        self._points = _no_points()
        self._pose: WarmPose | None = None
        self._previous: Solution | None = None  # pose followed before points were dropped
        self._search: FullAssessment | None = None      # the last assessment that searched
        self._assessed_revision = -1

    @property
    def field(self) -> Field:
        """Field of the bone for the tip of the probe."""
        return self._field

    @property
    def config(self) -> Config:
        """Settings in use."""
        return self._config

    @config.setter
    def config(self, config: Config) -> None:
        """Use these settings; the next assessment searches again."""
        self._config, self._search = config, None
        field = self._field.for_tip(config.probe.tip_radius)
        if field is not self._field:    # the pose so far is that of another surface
            self._field, self._points, self.ready = field, _no_points(), False
            self._pose = self._previous = self.assessment = None
            self.revision, self._assessed_revision = -1, -2     # ignores a running assessment

    @property
    def count(self) -> int:
        """Number of points followed."""
        return len(self._points.stamps)

    def follow(self, revision: int, points: Points) -> LivePose | None:
        """
        Add the points that are new.

        Parameters
        ----------
        revision : int
            Changes whenever points are dropped or replaced; the pose then starts again.
        points : Points
            All points, not only the new ones. They are kept without a copy, so they must not be
            modified.

        Returns
        -------
        LivePose or None
            The pose, if there are new points and the pose is trusted.

        """
        if revision != self.revision:
            self._restart(revision, points)
        new = points.positions[self.count:]
        self._points = points
        if not len(new):
            return None
        if self._pose is not None:
            self._pose.add(new)
        return self._trusted_pose()

    def assessment_job(self, search: bool = True, guess: Array | None = None,
                       evidence: Evidence = Evidence()) -> AssessmentJob:
        """
        Return a full assessment of the current points, ready to run; `accept` takes its result.

        Parameters
        ----------
        search : bool
            Whether to search the bone if that is due, see `search_due`.
        guess : (4, 4) float, optional
            T_bone_tracker; the search starts here.
        evidence : Evidence
            What is known of the pose besides the points.

        """
        self._assessed_revision = self.revision
        previous = self._previous if self._pose is None else self._pose.solution
        # After points were dropped, first continue from the previous pose: a search takes longer
        search = search and self._previous is None
        reasons = () if self._search is None else self._search.rejection_reasons
        threshold = self._search_threshold() if search else float('inf')
        points, field, config = self._points, self._field, self._config

        def job(cancelled: Callable[[], bool]) -> FullAssessment:
            return assess_all_points(points, field, config, previous=previous, guess=guess,
                                     evidence=evidence, search_threshold=threshold,
                                     previous_reasons=reasons, cancelled=cancelled)
        return job

    def accept(self, assessment: FullAssessment) -> LivePose | None:
        """
        Continue from an assessment and return the pose if it is trusted.

        An assessment of points that have been dropped since is ignored.
        """
        if self._assessed_revision != self.revision:
            return None
        self.assessment, self._pose, self._previous = assessment, assessment.pose, None
        if assessment.searched:
            self._search = assessment
            self.ready = assessment.trusted and not assessment.rejection_reasons
        if self._pose is not None:
            self._pose.add(self._points.positions[len(assessment.points.stamps):])
        return self._trusted_pose() if self.count else None

    @property
    def search_due(self) -> bool:
        """Whether enough points were added to search the bone again."""
        return (self.assessment is not None
                and self.assessment.on_strokes >= self._search_threshold())

    def registration_finished(self, success: bool) -> None:
        """After a registration, search again from its pose; after a refusal, clear `ready`."""
        if success:
            self._search = None
        else:
            self.ready = False

    def status(self) -> LiveStatus:
        """Return the present state."""
        found = self.assessment
        if found is None:
            return LiveStatus()
        status = LiveStatus(self.ready, used=found.used, predicted_tre_m=found.predicted_tre_m,
                            stroke_reports=found.stroke_reports)
        rms = found.predicted_tre_m.get('rms')
        error = '' if rms is None else f'; expected error {format_error(rms)} (RMS) over the bone'
        if self.ready:
            return replace(status, message=f'enough points: register now{error}')
        refusal = found.rejection_reason
        if refusal is not None:
            message = refusal.message
            if refusal.reason is Reason.TOO_FEW_POINTS:     # without the count, which changes often
                message = (f'drag the probe over the bone: at least '
                           f'{self._config.limits.min_points} points are needed')
            return replace(status, message=message, reason=refusal.reason,
                           touch_next=refusal.advice)
        return replace(status, message='checking for an alternative pose' + error
                       if found.trusted else 'searching for the bone')

    def _search_threshold(self) -> float:
        """Return the number of points on strokes at which to search."""
        if self._search is None:
            return 1
        if not self._search.trusted:
            return GROWTH_WITHOUT_POSE * self._search.on_strokes
        changed = (self.assessment is not None
                   and _reasons(self.assessment) != _reasons(self._search))
        return (GROWTH_AFTER_CHANGE if changed else GROWTH) * self._search.on_strokes

    def _restart(self, revision: int, points: Points) -> None:
        """Start again; if points were only dropped, remember the pose to continue from it."""
        only_dropped = self.count and np.isin(points.positions, self._points.positions).all()
        trusted = self.assessment is not None and self.assessment.trusted
        self._previous = (self._pose.solution
                          if only_dropped and trusted and self._pose is not None else None)
        self._pose = self.assessment = self._search = None
        self.ready = False
        self.revision, self._points = revision, _no_points()

    def _trusted_pose(self) -> LivePose | None:
        """Return the pose as of the newest point, or None if it is not trusted."""
        if self._pose is None or self.assessment is None or not self.assessment.trusted:
            return None
        covariance = self._pose.covariance
        if covariance is None:
            return None
        return LivePose(self._pose.T_tracker_bone, covariance, float(self._points.stamps[-1]))


def _no_points() -> Points:
    return without_tools(np.zeros((0, 3)), np.zeros(0), *np.zeros((2, 0), np.int32))


def _reasons(assessment: FullAssessment) -> set[Reason]:
    return {refusal.reason for refusal in assessment.rejection_reasons}
