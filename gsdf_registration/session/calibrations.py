# SPDX-License-Identifier: Apache-2.0
"""The calibration of a session that runs: it is started by a call, and ended by the next one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Sample
from gsdf_registration.session.calibration import (
    Calibration,
    CalibrationKind,
    CalibrationProgress,
    answer_of,
    joint_landmark,
)
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.notices import Notices
from gsdf_registration.session.state import SessionState


class Calibrations:
    """
    Searches for the tip of the probe and for the centre of a joint, one at a time; thread-safe.

    Parameters
    ----------
    lock : of the session, for its state and this object
    state, notices : of the session

    """

    def __init__(self, lock: threading.Lock, state: SessionState, notices: Notices) -> None:
        self._lock = lock
        self._state = state
        self._notices = notices
        self._running: Calibration | None = None

    @property
    def progress(self) -> CalibrationProgress | None:
        """The progress of the calibration that runs; None: none runs."""
        running = self._running
        return None if running is None else running.progress

    def take(self, sample: Sample) -> bool:
        """Use a sample as it was received; return whether it was used."""
        if self._running is None:
            return False
        with self._lock:
            cause = None if self._running is None else self._running.take(sample)
            if cause is not None:
                self._state.count_rejected({cause.value: 1})
            return cause is not None

    def add_reference_pose(self, stamp: float, T: Array) -> None:
        """Use a pose (4, 4), m, of the reference array in the tracker frame."""
        if self._running is not None:
            with self._lock:
                if self._running is not None:
                    self._running.add_reference_pose(stamp, T)

    def calibrate_tip(self) -> Answer:
        """
        Start to calibrate the tip; the next call ends it and takes a moment.

        The detail of the answer is then the `FixedPoint`.  The session does not use it until
        ``probe.tip`` is set, see `Session.configure`.
        """
        return self.call(CalibrationKind.TIP)

    def find_joint_centre(self) -> Answer:
        """Start to search for the centre of a joint; the next call ends it and takes a moment."""
        return self.call(CalibrationKind.JOINT_CENTRE)

    def call(self, kind: CalibrationKind) -> Answer:
        """Start a calibration, or end the one that runs, which takes a moment."""
        answer = self.begin_or_end(kind)
        return answer if isinstance(answer, Answer) else answer()

    def begin_or_end(self, kind: CalibrationKind) -> Answer | Callable[[], Answer]:
        """
        Start a calibration and return the answer, or end the one that runs.

        After the end a function is returned that takes a moment to find the answer.
        """
        with self._lock:
            running, self._running = self._running, None
            if running is None:
                problem = ('' if kind is CalibrationKind.TIP
                           else _why_no_joint_centre(self._state.config))
                if problem:
                    return Answer(False, problem)
                self._running = Calibration(kind)
                self._notices.set('')
                return Answer(True, f'{kind.sentence}, then call ~/{kind.value} again')
            if running.kind is not kind:
                self._running = running
                return Answer(False, f'{running.kind.sentence}, and end this first: call '
                              f'~/{running.kind.value}')
        return partial(self._tip if kind is CalibrationKind.TIP else self._joint_centre, running)

    def _tip(self, running: Calibration) -> Answer:
        return answer_of(running.solve(self._state.config.gate.max_age), 'the tool')

    def _joint_centre(self, running: Calibration) -> Answer:
        found = running.solve(self._state.config.gate.max_age)
        with self._lock:
            config = self._state.config
            problem = _why_no_joint_centre(config)
            if problem or not found.success:
                return Answer(False, problem) if problem else answer_of(found, '')
            landmark = joint_landmark(found, float(running.array.stamps[-1]), config)
            self._state.add_joint_centre(landmark)
        return Answer(True, f'landmark "{landmark.name}" found, standard deviation '
                      f'{1e3 * landmark.sigma_m:.1f} mm; '
                      f'{answer_of(found, "the reference array").message}', landmark)

    def drop(self) -> None:
        """End the calibration that runs without a result; the session is locked."""
        self._running = None

    def cancel(self, reason: str) -> None:
        """End the calibration that runs without a result, and show the reason."""
        with self._lock:
            if self._running is not None:
                self._running = None
                self._notices.set(f'the calibration is cancelled: {reason}', warning=True)


def _why_no_joint_centre(config: Config) -> str:
    """Return why the centre of a joint cannot be searched; empty if it can."""
    name = config.landmarks.joint_centre
    if not config.reference.topic:
        return ('there is no reference array, whose poses show how the limb swings; set '
                'reference.topic')
    if name not in config.landmarks.names:
        return (f'the place of "{name}" on the bone is not known; add "{name}" to landmarks.names '
                'and its place to landmarks.positions')
    return ''
