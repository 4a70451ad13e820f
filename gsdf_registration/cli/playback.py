# SPDX-License-Identifier: Apache-2.0
"""Plays a recording on the page of the console, through the session that the node uses."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.live.worker import LiveWorker
from gsdf_registration.session import Session
from gsdf_registration.session.operator_replay import Settle
from gsdf_registration.session.replay import begin
from gsdf_registration.session.status_values import combined_status, status_values
from gsdf_registration.visualization.console_page import ConsolePage
from gsdf_registration.visualization.console_panel import Tracker
from gsdf_registration.visualization.marker_scene import MarkerScene
from gsdf_registration.visualization.timeline import Timeline
from msg_adapters.recording import Recording

PERIOD = 0.03       # s, between two steps of the tip
STATUS_PERIOD = 0.2     # s, between two looks at the status


def show_session(page: ConsolePage, scene: MarkerScene, session: Session, field: Field) -> None:
    """Draw the accepted registration of a session with its points, or the bone alone."""
    result, points = session.status().pose_result, session.registered_points()
    if (result is None or points is None or result.T_tracker_bone is None
            or result.covariance is None or result.residuals_m is None or result.weights is None):
        page.show_markers(scene.bone(field))
        return
    contacts = field.contacts_at(result.T_tracker_bone, points.positions)
    page.show_markers(scene.pose(field, session.config.limits, result.T_tracker_bone,
                                 result.covariance, contacts, result.residuals_m,
                                 result.weights, ()))


class Playback:
    """
    A recording with a clock that can be paused, changed in speed, and set.

    `run` advances it in the calling thread. The other methods may be called from any thread.

    Parameters
    ----------
    recording : Recording
        With stamps.
    field : Field
        For the tip of the probe.
    settle : function
        As of `replay_events`.

    """

    def __init__(self, recording: Recording, field: Field, settle: Settle) -> None:
        stamps = np.zeros(1) if recording.stamps is None else recording.stamps
        self._times: Array = np.maximum.accumulate(stamps - stamps[0])
        self._recording, self._field, self._settle = recording, field, settle
        self._scene, self._lock = MarkerScene(), threading.Lock()
        self._live: LiveWorker | None = None
        self._progress: float | None = None
        self._shown: tuple[Any, ...] = ()
        self._stopping = threading.Event()

    @property
    def duration(self) -> float:
        """Length of the recording, s."""
        return float(self._times[-1])

    def register(self) -> tuple[bool, str]:
        """Register with the points up to now; return success and a sentence."""
        def show(share: float) -> None:
            self._progress = share
        try:
            result = self._session.register(progress=show)
        finally:
            self._progress = None
        if self._live is not None:
            self._live.registration_finished(result.success)
        return result.success, result.message

    def stop(self) -> None:
        """End `run`."""
        self._stopping.set()

    def run(self, page: ConsolePage, timeline: Timeline) -> None:
        """Play on ``page``, with the clock of ``timeline``, until `stop`."""
        self._page = page
        self._begin()
        last = shown = time.monotonic()
        while not self._stopping.wait(PERIOD):
            now = time.monotonic()
            moment = timeline.advance(now - last)
            last = now
            if moment < self._moment:
                self._begin()
            self._advance(moment)
            if now - shown >= STATUS_PERIOD:
                shown = now
                timeline.show()
                self._show()
        self._end()

    def _begin(self) -> None:
        """Start again from the first sample."""
        self._end()
        self._session, steps = begin(self._recording, self._field, self._settle)
        self._session.listen(self._on_event)
        self._steps: Iterator[int] = steps
        self._row: int | None = next(steps, None)
        self._moment = 0.0
        self._tip: Array | None = None
        self._T_bone_points: Array | None = None
        self._shown = ()
        self._live = LiveWorker(self._session, self._field, on_pose=self._on_pose,
                                on_assessment=self._on_assessment,
                                on_status_change=lambda: None, on_error=print)

    def _end(self) -> None:
        if self._live is not None:
            self._live.stop()
        self._live = None

    def _advance(self, moment: float) -> None:
        """Add the samples up to ``moment``, s."""
        self._moment = moment
        while self._row is not None and self._times[self._row] <= moment:
            self._row = next(self._steps, None)
        pose, tip = self._T_bone_points, self._tip
        self._page.show_tip(None if pose is None or tip is None
                            else transform(pose, tip[None])[0])

    def _show(self) -> None:
        """Show the status, and the registration if it has changed."""
        session, live = self._session, self._live
        assert live is not None     # between `_begin` and `_end`
        status = replace(combined_status(session.status(), live.status), progress=self._progress)
        self._page.show_status(status_values(status, live.status), status.message)
        arrived = self._times[self._times <= self._moment]
        self._page.show_tracker(Tracker(float((arrived > self._moment - 1.0).sum()),
                                        self._moment - float(arrived[-1])))
        shown = (status.session_id, status.registration_id)
        if shown != self._shown:
            self._shown = shown
            result = status.pose_result
            if result is not None and result.T_tracker_bone is not None:
                self._T_bone_points = inverse(result.T_tracker_bone)
            with self._lock:
                show_session(self._page, self._scene, session, self._field)

    def _on_event(self, event: str, value: Any) -> None:
        if event == 'point':
            self._tip = np.array(value[3:6])
        live = self._live
        if live is not None and event != 'rejected':
            live.notify()

    def _on_pose(self, pose: LivePose, _: str) -> None:
        if self._session.status().pose_result is None:
            self._T_bone_points = inverse(pose.T_tracker_bone)

    def _on_assessment(self, found: FullAssessment) -> None:
        if found.T_tracker_bone is None or found.covariance is None:
            return
        contacts = self._field.contacts_at(found.T_tracker_bone, found.points.positions)
        with self._lock:
            self._page.show_markers(self._scene.pose(
                self._field, self._session.config.limits, found.T_tracker_bone, found.covariance,
                contacts, found.residuals_m, found.weights, found.next_touches))
