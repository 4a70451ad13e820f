# SPDX-License-Identifier: Apache-2.0
"""
Runs the live registration on two threads.

The first waits for points, follows them and reports the pose. The second runs the full assessments.
"""

from __future__ import annotations

import threading
import traceback
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from time import monotonic
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

# Hz, of the live pose. A follow step takes about 1 ms, so this leaves the other threads their time;
# points that arrive faster share a step.
MAX_RATE = 100.0
# Hz, of the full assessments, and so of status and markers: fast enough for an operator to read,
# and each takes up to a second of one core.
ASSESSMENT_RATE = 2.0
# s between two searches, each about 0.6 s of one core. After an undo the search does not wait.
SEARCH_INTERVAL = 2.0
STOP_TIMEOUT = 0.5      # s


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


class LiveWorker:
    """
    Follows the points of one source on one bone, from construction until `stop`.

    Parameters
    ----------
    source : PointSource
    field : of the bone
    on_pose : called with each new pose and its frame
    on_assessment : called with each full assessment
    on_status_change : called when `status` may have changed
    on_error : called with a description of an internal error

    The callbacks run on the threads of the worker. After an internal error the registration starts
    again.

    """

    def __init__(self, source: PointSource, field: Field, *,
                 on_pose: Callable[[LivePose, str], None],
                 on_assessment: Callable[[FullAssessment], None],
                 on_status_change: Callable[[], None],
                 on_error: Callable[[str], None]) -> None:
        self._source, self._field = source, field
        self._on_pose, self._on_assessment = on_pose, on_assessment
        self._on_status_change, self._on_error = on_status_change, on_error
        self._live = LiveRegistration(field, source.config)
        self._status = -1, LiveStatus()     # with the revision of its points
        self._frame_id = ''
        self._finished: deque[bool] = deque()       # registrations: whether each succeeded
        self._notified, self._stopping = threading.Event(), threading.Event()
        self._assessing: Future[FullAssessment] | None = None
        self._cancel = threading.Event()    # the assessment that runs
        self._assessed = (-1, 0)            # revision and count of the points of the last one
        self._assessed_at = 0.0             # s, monotonic; the next two likewise
        self._next_assessment = self._next_search = 0.0
        self._measured = NO_LANDMARKS       # of the last search, with a standard deviation
        self._pool = ThreadPoolExecutor(1, 'assessment')
        self._thread = threading.Thread(target=self._run, name='live', daemon=True)
        self._thread.start()
        self.notify()       # the source may hold points already

    @property
    def status(self) -> LiveStatus:
        """The last status; the default while the points it describes have been dropped."""
        revision, status = self._status
        return status if revision == self._source.revision else LiveStatus()

    def notify(self) -> None:
        """Check the source for changes; returns at once, also if the source is locked."""
        self._notified.set()

    def registration_finished(self, success: bool) -> None:
        """Search again, after a registration that succeeded or was refused."""
        self._finished.append(success)
        self.notify()

    def stop(self) -> None:
        """Stop within half a second; a running assessment is cancelled."""
        self._stopping.set()
        self._cancel.set()
        self.notify()
        self._pool.shutdown(wait=False)
        self._thread.join(STOP_TIMEOUT)

    def _run(self) -> None:
        next_step = 0.0
        while True:
            self._notified.wait(self._wait_time())
            early = next_step - monotonic()
            if early > 0.0:
                self._stopping.wait(early)
            self._notified.clear()
            if self._stopping.is_set():
                return
            next_step = monotonic() + 1.0 / MAX_RATE
            try:
                self._step()
            # noqa: BLE001 - an internal error must neither stop the thread nor lose points
            except Exception as error:
                self._recover(error)

    def _step(self) -> None:
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

    def _wait_time(self) -> float | None:
        """Return how long to wait for a notification, s; None: without limit."""
        if self._assessing is not None:
            return None     # its end notifies
        due = self._assessment_due()
        return None if due is None else max(0.0, due - monotonic())

    def _assessment_due(self) -> float | None:
        """Return when to assess again, s, monotonic; None: not before something changes."""
        live = self._live
        if (live.revision, live.count) != self._assessed:
            return self._next_assessment
        return max(self._next_assessment, self._next_search) if live.search_due else None

    def _assess_if_due(self) -> None:
        """Start a full assessment of all points if it is time."""
        due, now = self._assessment_due(), monotonic()
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
        self._assessing = self._pool.submit(self._assess, job, self._cancel)
        self._assessing.add_done_callback(lambda _: self.notify())

    def _assess(self, job: AssessmentJob, cancel: threading.Event) -> FullAssessment:
        """Run a full assessment and report it, on the second thread."""
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

    def _recover(self, error: Exception) -> None:
        """Report an internal error and start again from the first point."""
        trace = ''.join(traceback.format_exception(error))
        self._on_error('the live registration restarts after an internal error, please report it: '
                       f'{type(error).__name__}: {error}\n{trace}')
        self._live = LiveRegistration(self._field, self._source.config)
        self._assessed, self._assessing = (-1, 0), None
        self._next_assessment = self._next_search = monotonic() + SEARCH_INTERVAL
