# SPDX-License-Identifier: Apache-2.0
"""
A registration that is kept up while points come in.

Two paces: `LiveRegistration.follow` takes in what came, by a warm solve, within a millisecond. A
survey looks at all points, now and then with a search from anywhere; it takes up to a second, so it
is a job for another thread. What it does not trust is never shown as a pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from dataclasses import field as item
from functools import partial
from typing import NamedTuple

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.field import Field
from gsdf_registration.live.assessment import FullAssessment, survey
from gsdf_registration.live.warm_pose import WarmPose
from gsdf_registration.registration.stroke_report import StrokeReport
from gsdf_registration.solver import Solution

# The bone is searched for again with so many times the points on strokes of the last search: with
# a pose to follow, without one, and when what speaks against it has changed
GROWN, GROWN_IN_DOUBT, GROWN_IN_CHANGE = 2.0, 1.2, 1.1

Job = Callable[[Callable[[], bool]], FullAssessment]    # told whether to give up


class LivePose(NamedTuple):
    """
    The present estimate.

    T_tracker_bone : (4, 4) float, metres
    covariance : (6, 6) float, REP-103 order, m and rad
    stamp : float, s, of the newest point taken in
    """

    T_tracker_bone: Array
    covariance: Array
    stamp: float


@dataclass(frozen=True)
class LiveStatus:
    """
    How the live registration stands.

    ready : whether to register now
    message : one plain sentence: what lacks, and what to do; empty while there is nothing to say
    reason : of what lacks
    touch_next : where a touch would help, a sentence; empty if none would
    used : points the pose was found from
    predicted_tre_m : as of a `RegistrationResult`; empty without a pose
    strokes : a report of each; none unless the pose is trusted
    """

    ready: bool = False
    message: str = ''
    reason: Reason | None = None
    touch_next: str = ''
    used: int = 0
    predicted_tre_m: dict[str, float] = item(default_factory=dict)
    strokes: tuple[StrokeReport, ...] = ()


class LiveRegistration:
    """
    Follows the points of a session; not thread-safe, but its surveys may run on another thread.

    All it says follows from what it was given, in that order; it knows no time.

    Parameters
    ----------
    field : of the bone
    config : Config

    """

    def __init__(self, field: Field, config: Config) -> None:
        self.config = config
        self.revision, self.count = -1, 0       # as `Session.points_since` wants them
        self.survey: FullAssessment | None = None       # the last one
        self.ready = False      # whether a search has found a pose that `register` would accept
        self._field = field
        self._chunks: list[Points] = []
        self._pose: WarmPose | None = None
        self._before: Solution | None = None    # what was followed before points were dropped
        self._search: FullAssessment | None = None      # the last one that searched
        self._looked = -1       # the revision that was last looked at

    def follow(self, revision: int, points: Points) -> LivePose | None:
        """
        Take in what `Session.points_since` gave for our ``revision`` and ``count``.

        Returns the pose, if anything came in and it is to be trusted.
        """
        if revision != self.revision:
            self._begin_anew(revision, points)
        if not len(points.stamps):
            return None
        self._chunks.append(points)
        self.count += len(points.stamps)
        if self._pose is not None:
            self._pose.add(points.positions)
        return self._shown(points.stamps[-1])

    def look(self, search: bool = True, guess: Array | None = None) -> Job:
        """
        Return a survey of all points held by now, to be run; `accept` takes what it returns.

        Parameters
        ----------
        search : bool
            Whether it may search for the bone, if that is `due`.
        guess : (4, 4) float, optional
            T_bone_tracker, where to search first.

        """
        self._looked = self.revision
        before = self._before if self._pose is None else self._pose.solution
        # what followed points that were dropped goes on at once; the search comes next
        search = search and self._before is None
        last = () if self._search is None else self._search.rejection_reasons
        return partial(survey, self._held(), self._field, self.config, before,
                       self._search_from() if search else float('inf'), guess, last)

    def accept(self, survey: FullAssessment) -> LivePose | None:
        """Go on from a survey, unless points were dropped meanwhile; returns what `follow` does."""
        if self._looked != self.revision:
            return None
        self.survey, self._pose, self._before = survey, survey.pose, None
        if survey.searched:
            self._search = survey
            self.ready = survey.trusted and not survey.rejection_reasons
        held = self._held()
        if self._pose is not None:
            self._pose.add(held.positions[len(survey.points.stamps):])
        return self._shown(held.stamps[-1]) if len(held.stamps) else None

    @property
    def due(self) -> bool:
        """Whether the bone should be searched for; it may wait."""
        return self.survey is not None and self.survey.on_strokes >= self._search_from()

    def configure(self, config: Config) -> None:
        """Work by these settings from now on; what was found is judged anew by them."""
        self.config, self._search = config, None

    def registered(self, success: bool) -> None:
        """Know that a registration was asked for: go on from its pose, or do not say `ready`."""
        if success:
            self._search = None
        else:
            self.ready = False

    def status(self) -> LiveStatus:
        """Return how it stands."""
        survey = self.survey
        if survey is None:
            return LiveStatus()
        known = LiveStatus(self.ready, used=survey.used, predicted_tre_m=survey.predicted_tre_m,
                           strokes=survey.strokes)
        tre = survey.predicted_tre_m.get('rms')     # none where what came since hides it
        error = '' if tre is None else f'; expected error {1e3 * tre:.1f} mm (RMS) over the bone'
        if self.ready:
            return replace(known, message=f'enough: register now{error}')
        no = survey.rejection_reason
        if no is not None:
            few = no.reason is Reason.TOO_FEW_POINTS    # how many there are changes all the time
            message = (f'drag the probe over the bone: {self.config.limits.min_points} points at '
                       'least are needed') if few else no.message
            return replace(known, message=message, reason=no.reason, touch_next=no.touch)
        return replace(known, message='looking whether what was touched fits anywhere else' + error
                       if survey.trusted else 'looking for the bone')

    def _search_from(self) -> float:
        """Return with how many points on strokes the bone is searched for."""
        if self._search is None:
            return 1
        if not self._search.trusted:
            return GROWN_IN_DOUBT * self._search.on_strokes
        changed = self.survey is not None and _reasons(self.survey) != _reasons(self._search)
        return (GROWN_IN_CHANGE if changed else GROWN) * self._search.on_strokes

    def _begin_anew(self, revision: int, points: Points) -> None:
        """Forget all; but if these points were held before, only others not, remember the pose."""
        held = self._held()
        left = len(held.stamps) and np.isin(points.positions, held.positions).all()
        shown = self.survey is not None and self.survey.trusted
        self._before = self._pose.solution if left and shown and self._pose is not None else None
        self._pose = self.survey = self._search = None
        self.ready = False
        self.revision, self._chunks, self.count = revision, [], 0

    def _held(self) -> Points:
        """Return all points."""
        if not self._chunks:
            return Points(np.zeros((0, 3)), np.zeros(0), *np.zeros((2, 0), np.int32))
        self._chunks = [Points(*map(np.concatenate, zip(*self._chunks)))]
        return self._chunks[0]

    def _shown(self, stamp: float) -> LivePose | None:
        """Return the pose, if it is to be trusted."""
        if self._pose is None or self.survey is None or not self.survey.trusted:
            return None
        covariance = self._pose.covariance
        if covariance is None:
            return None
        return LivePose(self._pose.T_tracker_bone, covariance, float(stamp))


def _reasons(survey: FullAssessment) -> set[Reason]:
    return {refusal.reason for refusal in survey.rejection_reasons}
