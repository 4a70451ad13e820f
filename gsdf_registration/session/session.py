# SPDX-License-Identifier: Apache-2.0
"""
The work of an operator: capture landmarks, collect strokes, undo, register, verify.

The node and the offline replay use this class.  It needs neither ROS nor files, and may be called
from any thread: points are added while a registration runs.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Mapping
from typing import Any

from gsdf_registration.common.config import Config
from gsdf_registration.common.formatting import format_count, format_numbers
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points, Rejection, Sample
from gsdf_registration.common.tool_pose import TIP_UNKNOWN
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.registration.pipeline import register
from gsdf_registration.session.accepted_registration import AcceptedRegistration
from gsdf_registration.session.calibrations import Calibrations
from gsdf_registration.session.events import Listener
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.notices import Notices
from gsdf_registration.session.record import SessionRecord
from gsdf_registration.session.state import SessionState
from gsdf_registration.session.status import Status, count_points, make_status
from gsdf_registration.session.verification import Verification

__all__ = ['Answer', 'Session', 'Status']


class Session:
    """
    One bone, whose model may be loaded later, and one or more probes; thread-safe.

    It is the `SampleSink` of the point transformer.

    Attributes
    ----------
    calibrations : Calibrations
        Searches for the tip of the probe and for the centre of a joint.

    """

    def __init__(self, config: Config, field: Field | None = None) -> None:
        self._lock = threading.Lock()
        self._state = SessionState(config, field)
        self._notices = Notices(self._state)
        self._solving = False
        self.calibrations = Calibrations(self._lock, self._state, self._notices)
        # changes when the model changes or points are dropped: a running registration is then void
        self._generation = 0

    @property
    def config(self) -> Config:
        """Settings in force."""
        return self._state.config

    def listen(self, listener: Listener, from_start: bool = False) -> None:
        """
        Report every change to ``listener``, see `session.events`; several may listen.

        It is called in the thread that makes the change, while the session is locked: it must not
        call the session, raise, or block.  ``from_start``: first report the whole session.
        """
        with self._lock:
            self._state.listen(listener, from_start)

    def stop_listening(self, listener: Listener) -> None:
        """Report no further changes to ``listener``."""
        with self._lock:
            self._state.stop_listening(listener)

    def set_notice(self, text: str, warning: bool = False) -> None:
        """
        Add a notice to the status until the session is continued, cleared or registered.

        ``warning``: the operator should act on it.
        """
        with self._lock:
            self._notices.set(text, warning)

    def take(self, sample: Sample) -> bool:
        """Use a sample as it was received for a calibration that runs; return whether so."""
        return self.calibrations.take(sample)

    def add_reference_pose(self, stamp: float, T: Array) -> None:
        """Use a pose (4, 4), m, of the reference array for a calibration that runs."""
        self.calibrations.add_reference_pose(stamp, T)

    def add(self, sample: Sample) -> Rejection | None:
        """
        Add a tip position in the session frame, or return why it is rejected.

        It is used for landmarks and verification whether or not points are being collected.
        """
        with self._lock:
            return self._state.add(sample)

    def reject(self, sample: Sample, cause: Rejection) -> None:
        """Count a sample that could not be transformed into the session frame."""
        self.count_rejected({cause.value: 1})

    def count_rejected(self, counts: Mapping[str, int]) -> None:
        """Count samples that were rejected before, by cause."""
        with self._lock:
            self._state.count_rejected(counts)

    def restart(self, reason: str) -> None:
        """Clear without a request of the operator; listeners and the status report why."""
        with self._lock:
            self._clear(reason)
            self._notices.set(restart_notice(reason), warning=True)

    def collect(self, on: bool) -> Answer:
        """Start a stroke, or end it."""
        with self._lock:
            self._state.collect(on)
            if on:
                self._notices.on_stroke()
            return Answer(True, f'{"collecting a new stroke" if on else "not collecting"}; '
                          + count_points(self._state))

    def activate(self) -> Answer:
        """Start to collect when the node becomes active, if ``collect.automatic`` or before."""
        return self.collect(self.config.collect.automatic or self.collecting)

    def deactivate(self) -> Answer:
        """End the stroke and a calibration when the node becomes inactive."""
        self.calibrations.cancel('the node was deactivated')
        return self.collect(False)

    def undo(self) -> Answer:
        """
        Drop the stroke started last; the accepted registration stays until the next one.

        A stroke that was split automatically is dropped part by part; the answer mentions it.
        """
        with self._lock:
            dropped = self._state.undo()
            if dropped is None:
                return Answer(False, 'there is no stroke to undo')
            split = '' if not dropped.split_by else (
                f' after a {dropped.split_by}; undo again to drop the stroke before the '
                f'{dropped.split_by} too')
            return self._dropped(f'the last stroke, {format_count(dropped.points, "point")}{split}')

    def drop_stroke(self, number: int) -> Answer:
        """
        Drop a stroke by its number, as the status shows it, wherever it is in the session.

        The accepted registration stays until the next one.
        """
        with self._lock:
            dropped = self._state.drop_stroke(number)
            if dropped is None:
                present = format_numbers(self._state.collection.stroke_numbers)
                return Answer(False, f'there is no stroke {number}; ' + (
                    f'the strokes are {present}' if present else 'there are no strokes'))
            return self._dropped(f'stroke {number}, {format_count(dropped.points, "point")}')

    def _dropped(self, what: str) -> Answer:
        """Return the answer after a stroke was dropped; the session is locked."""
        self._notices.on_undo()
        self._generation += 1       # a running registration uses the points dropped
        cancelled = '; the running registration is cancelled' if self._solving else ''
        return Answer(True, f'dropped {what}{cancelled}; {count_points(self._state)} left')

    def clear(self) -> Answer:
        """Drop all points, landmarks and verification points, and withdraw the pose."""
        with self._lock:
            registered = self._state.accepted is not None
            calibrating = self.calibrations.progress is not None
            self._clear(None)
            return Answer(True, 'dropped all points, landmarks and verification points'
                          + ('; the pose is withdrawn' if registered else '')
                          + ('; the calibration is cancelled' if calibrating else ''))

    def withdraw_pose(self, reason: Withdrawal, message: str) -> None:
        """Withdraw the accepted registration, if there is one; the points stay."""
        with self._lock:
            self._state.withdraw_pose(reason, message)
            self._notices.on_undo()

    def set_initial_pose(self, T_tracker_bone: Array, frame_id: str = '') -> Answer:
        """
        Search around this pose (4, 4) first, in registrations and in the live search.

        It applies until a registration is accepted, the session is cleared, or another bone is
        used.  ``frame_id``: of the pose; empty: that of the points.
        """
        with self._lock:
            answer = self._state.set_initial_pose(T_tracker_bone, frame_id)
            self._notices.set(answer.message, warning=not answer.success)
            return answer

    def initial_pose(self) -> Array | None:
        """Return T_tracker_bone (4, 4) of the initial pose; None if there is none."""
        with self._lock:
            return self._state.guess

    def _clear(self, reason: str | None) -> None:
        self.calibrations.drop()
        self._state.clear(reason)
        self._notices.clear()
        self._generation += 1

    def capture_landmark(self, now: float | None = None) -> Answer:
        """
        Capture the stationary tip as the next landmark of ``landmarks.names``.

        Its points are not used in the fit.  With ``now``, local time, s, a probe that has not been
        seen lately is ignored.
        """
        with self._lock:
            return self._state.capture_landmark(now)

    def register(self, landmarks: Landmarks | None = None, T_tracker_bone: Array | None = None,
                 cancelled: Callable[[], bool] | None = None,
                 progress: Callable[[float], None] | None = None) -> RegistrationResult:
        """
        Register the bone with the points collected so far; points may be added meanwhile.

        After a refusal the accepted registration stays.  A call while another registration runs is
        refused at once and changes nothing.

        Parameters
        ----------
        landmarks : Landmarks, optional
            By default the captured ones.
        T_tracker_bone : (4, 4) float, optional
            Start pose; by default the initial pose, see `set_initial_pose`.
        cancelled, progress : optional
            Returns whether to cancel; receives the share that is done.

        """
        job = self.start_registration(landmarks, T_tracker_bone, cancelled, progress)
        return job if isinstance(job, RegistrationResult) else job()

    def start_registration(self, landmarks: Landmarks | None = None,
                           T_tracker_bone: Array | None = None,
                           cancelled: Callable[[], bool] | None = None,
                           progress: Callable[[float], None] | None = None
                           ) -> RegistrationResult | Callable[[], RegistrationResult]:
        """
        Return a function that registers the points of this moment; it must be called.

        If the request is refused at once, the refusal is returned.  Arguments as in `register`.
        """
        state = self._state
        with self._lock:
            if self._solving:
                return RegistrationResult.refused(
                    Reason.BAD_INPUT, 'a registration is already running; wait for its answer')
            field, config, generation = state.field, state.config, self._generation
            if field is None:
                return RegistrationResult.refused(
                    Reason.NO_MODEL, 'no bone model is loaded; set model.path')
            points, serials = state.collection.points(), state.collection.serials()
            received, frame_id = state.collection.received, state.collection.frame_id or ''
            rejected = dict(state.collection.counts)
            if state.tip_missing:
                refusal = RegistrationResult.refused(Reason.BAD_INPUT, TIP_UNKNOWN, len(serials))
                return dataclasses.replace(refusal, received=received, rejected=rejected)
            if landmarks is None:
                landmarks = state.landmarks.usable
            if T_tracker_bone is None:
                T_tracker_bone = state.guess
            air = state.air_positions()
            unused = state.unused_initial_pose
            self._solving = True

        def job() -> RegistrationResult:
            try:
                result = register(points.positions,
                                  field,
                                  config,
                                  landmarks=landmarks,
                                  air=air(),
                                  T_tracker_bone=T_tracker_bone,
                                  progress=progress,
                                  cancelled=lambda: self._generation != generation or
                                  (cancelled is not None and cancelled()))
            except BaseException:
                self._solving = False
                raise
            with self._lock:
                self._solving = False
                if self._generation != generation:
                    return RegistrationResult.refused(
                        Reason.NOT_CONVERGED,
                        'points were dropped or the model changed meanwhile; register again')
                result = dataclasses.replace(result, received=received, rejected=rejected)
                if result.success:
                    result = state.accept(AcceptedRegistration(result, points, serials, frame_id))
                else:
                    state.refuse(result)
                self._notices.on_registration()
                if unused:
                    self._notices.set(unused, warning=True)
                return result
        return job

    def verify(self, now: float | None = None) -> Answer:
        """
        Measure the distance from the stationary tip to the registered surface.

        The points measured there are dropped from the collection: they are never used in the fit.
        If an earlier verification point is touched again, the answer says how far it has moved.
        """
        with self._lock:
            answer = self._state.verify(now)
            withdrawn = self._state.withdrawn
            if withdrawn is not None and answer.detail is not None:
                self._notices.set(withdrawn.message, warning=True)
            return answer

    def set_model(self, field: Field) -> bool:
        """
        Set the bone model; return whether it replaces another bone.

        Points stay; registration, landmarks and verification points of another bone do not.
        """
        with self._lock:
            first = self._state.field is None
            other = self._state.set_model(field)
            if other:
                self._notices.clear()
                self._generation += 1
            return other and not first

    def configure(self, config: Config) -> None:
        """
        Apply new settings; points and landmarks stay as they are.

        With another ``probe.tip`` everything that was touched with a tool has another position.
        The accepted registration is withdrawn if it used such points.

        Raises
        ------
        InputError
            If the frame of the points changes while there are any; nothing is changed then.

        """
        with self._lock:
            state, revision = self._state, self._state.revision
            accepted = state.accepted
            state.configure(config)
            if state.revision != revision:
                self._generation += 1       # a running registration uses the former positions
            if accepted is not state.accepted and state.withdrawn is not None:
                self._notices.on_undo()
                self._notices.set(state.withdrawn.message, warning=True)

    @property
    def collecting(self) -> bool:
        """Whether points are being collected."""
        with self._lock:
            return self._state.collection.collecting

    @property
    def kept(self) -> int:
        """Number of points collected so far."""
        with self._lock:
            return len(self._state.collection)

    @property
    def solving(self) -> bool:
        """Whether a registration runs."""
        return self._solving

    @property
    def revision(self) -> int:
        """Changes whenever points are dropped or replaced, see `points_since`."""
        with self._lock:
            return self._state.revision

    def points(self) -> Points:
        """
        Return the points collected so far, as read-only views.

        While the tip of a tool is not known there are none: their positions are not known.
        """
        return self.points_since(-1, 0)[2]

    def points_since(self, revision: int, count: int) -> tuple[int, str, Points]:
        """
        Return the points added after the first ``count``, for followers of the collection.

        Returns
        -------
        revision : int
            If it differs from the argument, points were dropped or replaced; all are returned then.
            While the tip of a tool is not known there are none.
        frame_id : str
        points : Points
            Read-only views.

        """
        state = self._state
        with self._lock:
            begin = count if revision == state.revision else 0
            if state.tip_missing:       # the positions of the tip are not known yet
                begin = len(state.collection)
            return (state.revision, state.collection.frame_id or '', state.collection.points(begin))

    def registered_points(self) -> Points | None:
        """Return the points of the accepted registration, in the order of its residuals."""
        with self._lock:
            return None if self._state.accepted is None else self._state.accepted.points

    def landmarks(self) -> Landmarks:
        """Return the captured landmarks that say something about the pose."""
        with self._lock:
            return self._state.landmarks.usable

    def air(self) -> Array:
        """Return where tip and shaft were in the air (n, 3), m, unless it is not to be used."""
        with self._lock:
            positions = self._state.air_positions()
        return positions()      # outside the lock

    def verifications(self) -> tuple[Verification, ...]:
        """Return the verification points, in the order in which they were touched."""
        with self._lock:
            return tuple(self._state.verifications)

    def status(self) -> Status:
        """Return a snapshot for the operator."""
        with self._lock:
            return make_status(self._state, self._solving, self._notices,
                               self.calibrations.progress)

    def to_dict(self) -> dict[str, Any]:
        """
        Return the session in plain lists and numbers, SI units, ready for JSON.

        Raises
        ------
        InputError
            If there is no bone model: a session belongs to one.

        """
        with self._lock:
            if self._state.field is None:
                raise InputError(
                    'there is no bone model, so there is no session to save; set model.path')
            record, config = self._state.record(), self._state.config
        # outside the lock: it takes a while with many points
        return record.to_dict(config)

    def restore(self, record: Mapping[str, Any]) -> None:
        """
        Load a session saved by `to_dict`; the settings in force stay.

        Raises
        ------
        InputError
            If it belongs to another bone, or is damaged; nothing is changed then.

        """
        with self._lock:
            bone = self._bone_to_restore()
        # outside the lock: it takes a while with many points
        saved = SessionRecord.from_dict(record, bone)
        with self._lock:
            if self._bone_to_restore() != bone:
                raise InputError('another bone model was loaded meanwhile; load again')
            self._state.restore(saved)
            self._notices.on_registration()
            self._generation += 1

    def _bone_to_restore(self) -> str:
        """Return the hash of the bone; `InputError` if a session cannot be restored now."""
        if self._state.field is None:
            raise InputError('load the bone model before the session; set model.path')
        if self._solving:
            raise InputError('a registration is running; wait for its answer, then load')
        return self._state.field.bone_sha256


def restart_notice(reason: str) -> str:
    """Return the sentence on a restart for status and log."""
    return f'a new session was started: {reason}'
