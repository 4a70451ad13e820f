# SPDX-License-Identifier: Apache-2.0
"""
Decides when the live registration follows points, assesses all of them, and searches.

It has no thread: `worker` runs it beside a node, and a replay runs it by the clock of a recording.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Protocol

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.result import Cancelled, Refusal, RegistrationResult
from gsdf_registration.common.rigid import Array, inverse
from gsdf_registration.common.samples import Points
from gsdf_registration.field import Field
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.live.live_registration import (
    AssessmentJob,
    LivePose,
    LiveRegistration,
    LiveStatus,
)
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.free_space import NO_PLACES, places
from gsdf_registration.registration.input_checks import initial_guess
from gsdf_registration.registration.landmark_evidence import for_tip
from gsdf_registration.registration.landmarks import MIN_LANDMARKS

# Hz, of the full assessments, and so of status and markers: fast enough for an operator to read,
# and each takes up to a second of one core.
ASSESSMENT_RATE = 2.0
# s between two searches, each about 0.6 s of one core. After an undo the search does not wait.
SEARCH_INTERVAL = 2.0

# runs an assessment, at once or later; and the time, s
Submit = Callable[[Callable[[], FullAssessment]], Future[FullAssessment]]
Clock = Callable[[], float]


def run_now(job: Callable[[], FullAssessment]) -> Future[FullAssessment]:
    """Run an assessment in the calling thread."""
    finished: Future[FullAssessment] = Future()
    finished.set_result(job())
    return finished


class SourceStatus(Protocol):
    """The part of a session's status that the worker reads."""

    @property
    def pose_result(self) -> RegistrationResult | None:
        """The accepted registration."""

    @property
    def pose_frame_id(self) -> str:
        """Frame of its pose."""


class PointSource(Protocol):
    """Where the points come from: a session. Called from both threads."""

    @property
    def config(self) -> Config:
        """Settings in use."""

    @property
    def revision(self) -> int:
        """Changes whenever points are dropped or replaced."""

    @property
    def solving(self) -> bool:
        """Whether a registration runs."""

    def points_since(self, revision: int, count: int) -> tuple[int, str, Points]:
        """Return the revision, the frame of the points, and the points from row ``count`` on."""

    def landmarks(self) -> Landmarks:
        """Return the captured landmarks."""

    def air(self) -> Array:
        """Return where the probe was in the air (n, 3), m, tracker frame."""

    def initial_pose(self) -> Array | None:
        """Return T_tracker_bone (4, 4) to search around first; None: there is none."""

    def status(self) -> SourceStatus:
        """Return the present status."""


class LiveSteps:
    """
    Follows the points of one source on one bone; not thread-safe, but see `submit`.

    Parameters
    ----------
    source : PointSource
    field : of the bone
    on_pose : called with each new pose and its frame
    on_assessment : called with each full assessment, where ``submit`` runs it
    on_status_change : called when `status` may have changed
    submit : runs the assessments, in any thread; `step` is to be called when one has ended
    clock : returns the time, s

    """

    def __init__(self, source: PointSource, field: Field, *,
                 on_pose: Callable[[LivePose, str], None],
                 on_assessment: Callable[[FullAssessment], None],
                 on_status_change: Callable[[], None], submit: Submit, clock: Clock) -> None:
        self._source, self._field = source, field
        self._on_pose, self._on_assessment = on_pose, on_assessment
        self._on_status_change, self._submit, self._clock = on_status_change, submit, clock
        self._live = LiveRegistration(field, source.config)
        self._status = -1, LiveStatus()     # with the revision of its points
        self._frame_id = ''
        self._finished: deque[bool] = deque()       # registrations: whether each succeeded
        self._assessing: Future[FullAssessment] | None = None
        self._cancel = threading.Event()    # the assessment that runs
        self._assessed = (-1, 0)            # revision and count of the points of the last one
        self._assessed_at = 0.0             # s, by the clock; the next two likewise
        self._next_assessment = self._next_search = 0.0
        self._measured = NO_LANDMARKS       # of the last search, with a standard deviation

    @property
    def status(self) -> LiveStatus:
        """The last status; the default while the points it describes have been dropped."""
        revision, status = self._status
        return status if revision == self._source.revision else LiveStatus()

    def registration_finished(self, success: bool) -> None:
        """Let the next step search again, after a registration; from any thread."""
        self._finished.append(success)

    def cancel(self) -> None:
        """Cancel a running assessment."""
        self._cancel.set()

    def start_again(self) -> None:
        """Start again from the first point, after an internal error."""
        self._live = LiveRegistration(self._field, self._source.config)
        self._assessed, self._assessing = (-1, 0), None
        self._next_assessment = self._next_search = self._clock() + SEARCH_INTERVAL

    def step(self) -> None:
        """Follow new points, accept a finished assessment, report the pose, assess again if due."""
        live = self._live
        self._apply_requests()
        before = live.revision
        # all points from row 0: they are views, so nothing is copied
        revision, self._frame_id, points = self._source.points_since(before, 0)
        pose = live.follow(revision, points)
        if revision != before:
            self._cancel.set()
            self._assessed = (-1, 0)
            self._next_assessment = self._next_search = 0.0
            self._update_status()
        if self._assessing is not None and self._assessing.done():
            finished, self._assessing = self._assessing, None
            pose = self._accept(finished) or pose
        if pose is not None:
            self._on_pose(pose, self._frame_id)
        self._assess_if_due()

    def wait_time(self) -> float | None:
        """Return how long to wait for new points, s; None: without limit."""
        if self._assessing is not None:
            return None     # a step follows its end
        due = self._assessment_due()
        return None if due is None else max(0.0, due - self._clock())

    def _apply_requests(self) -> None:
        """Apply changed settings, landmarks and finished registrations: they allow a search."""
        config = self._source.config
        if config is not self._live.config:
            self._live.config = config
            self._next_search = 0.0
        measured = self._source.landmarks().measured
        if not measured.equals(self._measured):
            self._measured, self._live.config = measured, config    # the pose changes
            self._assessed, self._next_search = (-1, 0), 0.0
        while self._finished:
            self._live.registration_finished(self._finished.popleft())
            self._next_search = 0.0

    def _accept(self, finished: Future[FullAssessment]) -> LivePose | None:
        try:
            assessment = finished.result()
        except Cancelled:
            return None
        live = self._live
        pose = live.accept(assessment)
        if assessment.searched and live.assessment is assessment:
            self._next_search = self._assessed_at + SEARCH_INTERVAL
        self._update_status()
        return pose

    def _update_status(self) -> None:
        self._status = self._live.revision, self._live.status()
        self._on_status_change()

    def _assessment_due(self) -> float | None:
        """Return when to assess again, s, by the clock; None: not before something changes."""
        live = self._live
        if (live.revision, live.count) != self._assessed:
            return self._next_assessment
        return max(self._next_assessment, self._next_search) if live.search_due else None

    def _assess_if_due(self) -> None:
        """Start a full assessment of all points if it is time."""
        due, now = self._assessment_due(), self._clock()
        if self._assessing is not None or due is None or due > now:
            return
        live = self._live
        self._assessed = live.revision, live.count
        self._assessed_at = now
        # half the rate once the points suffice
        self._next_assessment = now + (2.0 if live.ready else 1.0) / ASSESSMENT_RATE
        self._cancel = threading.Event()
        search = now >= self._next_search and not self._source.solving
        landmarks = for_tip(self._source.landmarks(), live.field)
        evidence = Evidence(landmarks, places(self._source.air()) if search else NO_PLACES)
        job = live.assessment_job(search, self._guess(landmarks), evidence)
        self._assessing = self._submit(partial(self._assess, job, self._cancel))

    def _assess(self, job: AssessmentJob, cancel: threading.Event) -> FullAssessment:
        """Run a full assessment and report it."""
        assessment = job(cancel.is_set)
        if not cancel.is_set():
            self._on_assessment(assessment)
        return assessment

    def _guess(self, landmarks: Landmarks) -> Array | None:
        """Return T_bone_tracker (4, 4) where a registration would start; None: anywhere."""
        status = self._source.status()
        initial = self._source.initial_pose()
        if initial is not None:
            return inverse(initial)
        if len(landmarks) >= MIN_LANDMARKS:
            try:
                return initial_guess(landmarks, None)
            except Refusal:
                return None
        if status.pose_result is None or status.pose_frame_id != self._frame_id:
            return None
        return status.pose_result.T_bone_tracker
