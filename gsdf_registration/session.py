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

from gsdf_registration.collection import Collection, Points, Rejection
from gsdf_registration.config import Config
from gsdf_registration.field import Field
from gsdf_registration.registration import register
from gsdf_registration.result import InputError, Reason, RegistrationResult
from gsdf_registration.rigid import Array
from gsdf_registration.session_record import SessionRecord
from gsdf_registration.session_status import Status, counted, sentence
from gsdf_registration.touches import Answer, CapturedLandmark, Touches

__all__ = ['Answer', 'LandmarkPairs', 'Session', 'Status']

LandmarkPairs = tuple[Array, Array]     # (k, 3) model, bone frame; (k, 3) tracker; m


class Session:
    """
    One bone, one probe or several, one operator; thread-safe.

    ``field`` is the bone's gradient-SDF; it may come later, by `set_model`.
    """

    def __init__(self, config: Config, field: Field | None = None) -> None:
        self._lock = threading.Lock()
        self._config = config
        self._field = field
        self._collection = Collection(config.gate, config.collect.max_points, config.probe.frame_id)
        self._collection.collecting = config.collect.automatic
        self._touches = Touches(config.landmarks)
        self._source_of: dict[str, int] = {}
        self._solving = False
        self._result: RegistrationResult | None = None
        self._pose_result: RegistrationResult | None = None
        self._pose_points: Points | None = None
        self._pose_frame = ''
        self._fresh = False     # whether the last registration is the latest thing that happened
        # changes with the model and when all is cleared: older solves are void
        self._era = 0
        # changes whenever what is held does other than grow, so that who follows begins anew
        self._revision = 0

    def add_point(self, stamp: float, position: Sequence[float], frame_id: str, source: str = '',
                  arrival: float | None = None, quality: float | None = None) -> Rejection | None:
        """
        Take in one tip position; see `Collection.add`, but ``source`` is a name.

        The tip is watched for landmarks and verification whether or not points are being collected.
        """
        with self._lock:
            number = self._source_of.setdefault(source, len(self._source_of))
            rejection = self._collection.add(stamp, position, frame_id, number, arrival, quality)
            if rejection is None or not rejection.is_of_sample:
                x, y, z = position
                self._touches.tip.add(stamp, (float(x), float(y), float(z)), number, arrival)
            return rejection

    def count_dropped(self, dropped: Mapping[str, int]) -> None:
        """Count points that were refused before they came here, by cause."""
        with self._lock:
            for cause, count in dropped.items():
                counts = self._collection.counts
                counts[cause] = counts.get(cause, 0) + count
                self._collection.received += count

    def collect(self, on: bool) -> Answer:
        """Start a stroke, or end it."""
        with self._lock:
            if on:
                self._collection.start_stroke()
                self._fresh = False
                return Answer(True, f'collecting a new stroke; {self._held()}')
            self._collection.end_stroke()
            return Answer(True, f'not collecting; {self._held()}')

    def undo(self) -> Answer:
        """Drop the stroke begun last; a pose found with it stands until the next registration."""
        with self._lock:
            dropped = self._collection.undo()
            if dropped == 0:
                return Answer(False, 'there is no stroke to undo')
            self._fresh = False
            self._revision += 1
            return Answer(
                True, f'dropped the last stroke, {counted(dropped, "point")}; {self._held()}'
                + self._pose_stands())

    def clear(self) -> Answer:
        """Drop all points, landmarks and verification points; the last good pose stands."""
        with self._lock:
            self._collection.clear()
            self._touches = Touches(self._config.landmarks)
            self._result, self._fresh = None, False
            self._era += 1
            self._revision += 1
            return Answer(
                True, 'dropped all points, landmarks and verification points' + self._pose_stands())

    def capture_landmark(self, now: float | None = None) -> Answer:
        """
        Take the resting tip as the next landmark of ``landmarks.names``.

        Parameters
        ----------
        now : float, optional
            Time on the clock of the arrivals given to `add_point`, s; a probe not seen of late is
            left out.

        """
        with self._lock:
            return self._touches.capture(now)

    def register(self, landmarks: LandmarkPairs | None = None, T_tracker_bone: Array | None = None,
                 cancelled: Callable[[], bool] | None = None,
                 progress: Callable[[float], None] | None = None) -> RegistrationResult:
        """
        Find the bone with the points collected so far; points may come in meanwhile.

        A refusal leaves the last good pose.

        Parameters
        ----------
        landmarks : ((k, 3), (k, 3)) float, optional
            Model and tracker positions, m; without them those captured, if three or more.
        T_tracker_bone : (4, 4) float, optional
            A first guess.
        cancelled, progress : optional
            Asked whether to give up; told the share done.

        Returns
        -------
        RegistrationResult
            A refusal at once, not remembered, while another registration runs.

        """
        with self._lock:
            if self._solving:
                return RegistrationResult.refused(
                    Reason.BAD_INPUT, 'a registration is running already; wait for its answer')
            field, config, era = self._field, self._config, self._era
            if field is None:
                return RegistrationResult.refused(Reason.NO_MODEL,
                                                  'no bone model is loaded; set model.path')
            points, received = self._collection.arrays(), self._collection.received
            frame_id = self._collection.frame_id or ''
            if landmarks is None:
                landmarks = self._touches.pairs
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
            result = dataclasses.replace(result, received=received)
            self._result, self._fresh = result, True
            if result.success:
                self._pose_result, self._pose_points, self._pose_frame = result, points, frame_id
            return result

    def verify(self, now: float | None = None) -> Answer:
        """Measure how far the resting tip is from the registered surface; never used in the fit."""
        with self._lock:
            if self._pose_result is None or self._field is None:
                return Answer(False, 'there is no registration to verify; register first')
            if self._collection.frame_id not in (None, self._pose_frame):
                return Answer(
                    False, f'the tip is in frame "{self._collection.frame_id}", but the bone was '
                    f'registered in "{self._pose_frame}"; register again')
            return self._touches.verify(self._field, self._pose_result,
                                        self._config.limits.verification, now)

    def set_model(self, field: Field) -> None:
        """Take another bone; the points stay, a pose of another bone does not."""
        with self._lock:
            if self._field is None or self._field.bone_sha256 != field.bone_sha256:
                self._result = self._pose_result = self._pose_points = None
                self._touches.verifications, self._fresh = [], False
                self._era += 1
                self._revision += 1
            self._field = field

    def configure(self, config: Config) -> None:
        """
        Work by these settings from now on; points and landmarks held stay as they are.

        Raises
        ------
        InputError
            When ``probe.frame_id`` changes with points or landmarks held; nothing is changed then.

        """
        with self._lock:
            wanted = config.probe.frame_id
            if wanted != self._config.probe.frame_id:
                if len(self._collection) or self._touches.landmarks:
                    raise InputError(
                        'points or landmarks are held; clear before changing probe.frame_id')
                self._collection.want_frame(wanted)
            self._collection.gate = config.gate
            self._collection.max_points = config.collect.max_points
            self._touches.configure(config.landmarks)
            self._config = config

    def points(self) -> Points:
        """Return a copy of the points collected so far."""
        with self._lock:
            return self._collection.arrays()

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
        with self._lock:
            begin = count if revision == self._revision else 0
            return (self._revision, self._collection.frame_id or '', self._collection.arrays(begin))

    def registered_points(self) -> Points | None:
        """Return the points the last good pose was found with, in the order of its residuals."""
        with self._lock:
            return self._pose_points

    def landmarks(self) -> tuple[CapturedLandmark, ...]:
        """Return the landmarks captured so far."""
        with self._lock:
            return tuple(self._touches.landmarks)

    def status(self) -> Status:
        """Return the session at a glance."""
        with self._lock:
            collection, state = self._collection, self._state()
            return Status(state=state,
                          message=sentence(state, collection, self._result,
                                           self._held() + self._pose_stands(),
                                           self._touches.to_come),
                          received=collection.received,
                          kept=len(collection),
                          rejected=dict(collection.counts),
                          strokes=collection.strokes,
                          landmarks=len(self._touches.landmarks),
                          frame_id=collection.frame_id,
                          reason=None if self._result is None else self._result.reason,
                          result=self._result,
                          pose_result=self._pose_result,
                          pose_frame_id=self._pose_frame)

    def _state(self) -> str:
        if self._field is None:
            return 'no_model'
        if self._solving:
            return 'solving'
        if self._fresh and self._result is not None:
            return 'registered' if self._result.success else 'refused'
        return 'collecting' if self._collection.collecting else 'idle'

    def _held(self) -> str:
        points, strokes = len(self._collection), self._collection.strokes
        return f'{counted(points, "point")} in {counted(strokes, "stroke")} held'

    def _pose_stands(self) -> str:
        if self._pose_result is None:
            return ''
        return '; the last good pose stands until the next registration'

    def to_dict(self) -> dict[str, Any]:
        """
        Return all of the session in plain lists and numbers, SI units, ready for JSON.

        Raises
        ------
        InputError
            When there is no bone to bind it to.

        """
        with self._lock:
            if self._field is None:
                raise InputError(
                    'there is no bone model, so there is no session to save; set model.path')
            field, config = self._field, self._config
            record = SessionRecord(self._collection.frame_id, list(self._source_of),
                                   self._collection.arrays(), dict(self._collection.counts),
                                   list(self._touches.landmarks), list(self._touches.verifications),
                                   self._result, self._pose_result, self._pose_frame)
        # outside the lock: it takes a while with many points
        return record.to_dict(field, config)

    def restore(self, record: Mapping[str, Any]) -> None:
        """
        Take up a session saved by `to_dict`; settings stay those in force.

        Raises
        ------
        InputError
            When it belongs to another bone, or is damaged; nothing is changed then.

        """
        with self._lock:
            if self._field is None:
                raise InputError('load the bone model before the session; set model.path')
            if self._solving:
                raise InputError(
                    'a registration is running; wait for its answer before loading a session')
            saved = SessionRecord.from_dict(record, self._field)
            self._collection.refill(saved.points, saved.frame_id, saved.rejected)
            self._touches = Touches(self._config.landmarks)
            self._source_of = {name: number for number, name in enumerate(saved.source_names)}
            self._touches.landmarks = saved.landmarks
            self._touches.verifications = saved.verifications
            self._result, self._pose_result = saved.result, saved.pose_result
            self._pose_points, self._pose_frame = None, saved.pose_frame_id
            self._fresh = saved.result is not None
            self._era += 1
            self._revision += 1
