# SPDX-License-Identifier: Apache-2.0
"""
What an operator does: touch landmarks, collect strokes, undo, register, verify.

The node and the offline replay drive this very class.  It knows nothing of ROS or files and may be
called from any thread: points go in while a registration runs.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gsdf_registration.common.config import Config
from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points, Rejection
from gsdf_registration.field import Field
from gsdf_registration.registration.pipeline import register
from gsdf_registration.session.accepted_registration import AcceptedRegistration
from gsdf_registration.session.events import Listener
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.news import News
from gsdf_registration.session.record import SessionRecord
from gsdf_registration.session.state import SessionState
from gsdf_registration.session.status import Status, held, pose_stands, status_of

__all__ = ['Answer', 'LandmarkPairs', 'Session', 'Status']

LandmarkPairs = tuple[Array, Array]     # (k, 3) model, bone frame; (k, 3) tracker; m


class Session:
    """One bone, whose field may come later; one probe or several; one operator; thread-safe."""

    def __init__(self, config: Config, field: Field | None = None) -> None:
        self._lock = threading.Lock()
        self._holds = SessionState(config, field)
        self._solving = False
        self._news = News(self._holds)
        # changes with the model and when points are dropped: older solves are void
        self._era = 0

    def listen(self, listener: Listener, from_start: bool = False) -> None:
        """
        Tell ``listener`` every change of what is held, see `session_events`.

        It is called with the session locked, in the thread that changes it: it must not call the
        session, nor raise, nor take long.  ``from_start``: also of what is held by now.
        """
        with self._lock:
            self._holds.listen(listener)
            if from_start:
                self._holds.tell_all()

    def remark(self, text: str) -> None:
        """Have the status say this too, until the operator has gone on, cleared or registered."""
        with self._lock:
            self._news.remark(text)

    def add_point(self, stamp: float, position: Sequence[float], frame_id: str, source: str = '',
                  arrival: float | None = None, quality: float | None = None) -> Rejection | None:
        """
        Take in one tip position; see `Collection.add`, but ``source`` is a name.

        The tip is watched for landmarks and verification whether or not points are being collected.
        """
        with self._lock:
            return self._holds.add_point(stamp, position, frame_id, source, arrival, quality)

    def count_dropped(self, dropped: Mapping[str, int]) -> None:
        """Count points that were refused before they came here, by cause."""
        with self._lock:
            self._holds.count_dropped(dropped)

    def collect(self, on: bool) -> Answer:
        """Start a stroke, or end it."""
        with self._lock:
            self._holds.collect(on)
            if on:
                self._news.stroke()
            return Answer(True, f'{"collecting a new stroke" if on else "not collecting"}; '
                          + held(self._holds))

    def undo(self) -> Answer:
        """
        Drop the stroke begun last; a pose found with it stands until the next registration.

        What was split automatically is dropped part by part, and the answer says so.
        """
        with self._lock:
            dropped = self._holds.undo()
            if dropped is None:
                return Answer(False, 'there is no stroke to undo')
            self._news.undo()
            self._era += 1      # a registration that runs has what was dropped in it
            part = '; the registration under way is given up' if self._solving else ''
            if dropped.split_by:
                part = (f', which a {dropped.split_by} had split off the one before: undo again '
                        f'to drop that too{part}')
            return Answer(
                True, f'dropped the last stroke, {counted(dropped.points, "point")}{part}; '
                f'{held(self._holds)}')

    def clear(self) -> Answer:
        """Drop all points, landmarks and verification points; the last good pose stands."""
        with self._lock:
            self._holds.clear()
            self._news.end()
            self._era += 1
            return Answer(True, 'dropped all points, landmarks and verification points'
                          + pose_stands(self._holds))

    def capture_landmark(self, now: float | None = None) -> Answer:
        """
        Take the resting tip as the next landmark of ``landmarks.names``; it is not for the fit.

        At ``now``, s, on the clock of the arrivals given to `add_point`, a probe not seen of late
        is left out.
        """
        with self._lock:
            return self._holds.capture_landmark(now)

    def register(self, landmarks: LandmarkPairs | None = None, T_tracker_bone: Array | None = None,
                 cancelled: Callable[[], bool] | None = None,
                 progress: Callable[[float], None] | None = None) -> RegistrationResult:
        """
        Find the bone with the points collected so far; points may come in meanwhile.

        A refusal leaves the last good pose; while another registration runs, that comes at once and
        is not remembered.

        Parameters
        ----------
        landmarks : ((k, 3), (k, 3)) float, optional
            Model and tracker positions, m; without them those captured, if three or more.
        T_tracker_bone : (4, 4) float, optional
            A first guess.
        cancelled, progress : optional
            Asked whether to give up; told the share done.

        """
        holds = self._holds
        with self._lock:
            if self._solving:
                return RegistrationResult.refused(
                    Reason.BAD_INPUT, 'a registration is running already; wait for its answer')
            field, config, era = holds.field, holds.config, self._era
            if field is None:
                return RegistrationResult.refused(
                    Reason.NO_MODEL, 'no bone model is loaded; set model.path')
            points, serials = holds.collection.arrays(), holds.collection.serials()
            received, frame_id = holds.collection.received, holds.collection.frame_id or ''
            if landmarks is None:
                landmarks = holds.touches.pairs
            self._solving = True
        try:
            result = register(points.positions,
                              field,
                              config,
                              landmarks=landmarks,
                              T_tracker_bone=T_tracker_bone,
                              progress=progress,
                              cancelled=lambda: self._era != era or
                              (cancelled is not None and cancelled()))
        except BaseException:
            self._solving = False
            raise
        with self._lock:
            self._solving = False
            if self._era != era:
                return RegistrationResult.refused(
                    Reason.NOT_CONVERGED, 'points or model were dropped meanwhile; register again')
            answer = holds.register(AcceptedRegistration(dataclasses.replace(result, received=received),
                                                 points, serials, frame_id))
            self._news.registration()
            return answer

    def verify(self, now: float | None = None) -> Answer:
        """
        Measure how far the resting tip is from the registered surface; never used in the fit.

        What the tip delivers while it rests there is taken out of the collection again.  Where an
        earlier verification point is touched again, the answer says how far it has moved since.
        """
        with self._lock:
            return self._holds.verify(now)

    def set_model(self, field: Field) -> bool:
        """Take a bone, tell if in another's place: then points stay, pose and landmarks do not."""
        with self._lock:
            first = self._holds.field is None
            other = self._holds.set_model(field)
            if other:
                self._news.end()
                self._era += 1
            return other and not first

    def configure(self, config: Config) -> None:
        """
        Work by these settings from now on; points and landmarks held stay as they are.

        Raises
        ------
        InputError
            When the frame of the points changes while any are held; nothing is changed then.

        """
        with self._lock:
            self._holds.configure(config)

    @property
    def collecting(self) -> bool:
        """Whether points are being collected."""
        with self._lock:
            return self._holds.collection.collecting

    @property
    def revision(self) -> int:
        """What `points_since` returns: another one when points were dropped or replaced."""
        with self._lock:
            return self._holds.revision

    def points(self) -> Points:
        """Return a copy of the points collected so far."""
        with self._lock:
            return self._holds.collection.arrays()

    def points_since(self, revision: int, count: int) -> tuple[int, str, Points]:
        """
        Return what has come in since ``count`` points were held, for who follows the collection.

        Returns
        -------
        revision : int
            If it is another than given, points were dropped or replaced and all are returned.
        frame_id : str
        points : Points

        """
        holds = self._holds
        with self._lock:
            begin = count if revision == holds.revision else 0
            return (holds.revision, holds.collection.frame_id or '', holds.collection.arrays(begin))

    def registered_points(self) -> Points | None:
        """Return the points the last good pose was found with, in the order of its residuals."""
        with self._lock:
            return None if self._holds.pose is None else self._holds.pose.points

    def landmarks(self) -> LandmarkPairs | None:
        """Return where a registration begins, if three landmarks or more are captured."""
        with self._lock:
            return self._holds.touches.pairs

    def status(self) -> Status:
        """Return the session at a glance."""
        with self._lock:
            return status_of(self._holds, self._solving, self._news)

    def to_dict(self) -> dict[str, Any]:
        """
        Return all of the session in plain lists and numbers, SI units, ready for JSON.

        Raises
        ------
        InputError
            When there is no bone to bind it to.

        """
        with self._lock:
            if self._holds.field is None:
                raise InputError(
                    'there is no bone model, so there is no session to save; set model.path')
            record, config = self._holds.record(), self._holds.config
        # outside the lock: it takes a while with many points
        return record.to_dict(config)

    def restore(self, record: Mapping[str, Any]) -> None:
        """
        Take up a session saved by `to_dict`; settings stay those in force.

        Raises
        ------
        InputError
            When it belongs to another bone, or is damaged; nothing is changed then.

        """
        holds = self._holds
        with self._lock:
            if holds.field is None:
                raise InputError('load the bone model before the session; set model.path')
            if self._solving:
                raise InputError('a registration is running; wait for its answer, then load')
            holds.restore(SessionRecord.from_dict(record, holds.field.bone_sha256))
            self._news.registration()
            self._era += 1
