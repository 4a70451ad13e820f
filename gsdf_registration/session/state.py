# SPDX-License-Identifier: Apache-2.0
"""What a session holds; whoever listens is told of every change, see `session_events`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.samples import Points, Rejection
from gsdf_registration.field import Field
from gsdf_registration.registration.stroke_report import StrokeReport, interference
from gsdf_registration.session.accepted_registration import AcceptedRegistration
from gsdf_registration.session.collection import Collection, Stroke
from gsdf_registration.session.events import Listener
from gsdf_registration.session.landmark_capture import Answer, LandmarkCapture
from gsdf_registration.session.record import SessionRecord, fit_of, plain
from gsdf_registration.session.stationary_tip import StationaryTip
from gsdf_registration.session.verification import measured_anew


def _tell_nobody(event: str, value: Any) -> None:
    pass


class SessionState:
    """Points, landmarks, verification points and poses of one bone; not thread-safe."""

    def __init__(self, config: Config, field: Field | None) -> None:
        self.config = config
        self.field = field
        self.collection = Collection(config.gate, config.collect.max_points, config.points_frame)
        self.collection.collecting = config.collect.automatic
        self.touches = LandmarkCapture(config.landmarks)
        self.result: RegistrationResult | None = None   # the last one, refused or not
        self.pose: AcceptedRegistration | None = None           # the last good one
        # changes whenever what is held does other than grow, so that who follows begins anew
        self.revision = 0
        self._source_of: dict[str, int] = {}
        self._told_frame: str | None = None
        self._tell: Listener = _tell_nobody
        self._reports: tuple[tuple[Any, ...], tuple[StrokeReport, ...]] = ((), ())

    def listen(self, listener: Listener) -> None:
        """Tell ``listener`` of all that happens from now on."""
        self._tell = listener
        self._told_frame = None
        listener('model', self._model_sha256)
        listener('collecting', self.collection.collecting)

    def tell_all(self) -> None:
        """Tell whoever listens of all that is held, as if it had just been loaded."""
        if len(self.collection) or self.touches.landmarks or self.pose is not None:
            self._tell('session', self.record().to_dict(self.config))

    @property
    def _model_sha256(self) -> str | None:
        return None if self.field is None else self.field.bone_sha256

    def add_point(self, stamp: float, position: Sequence[float], frame_id: str, source: str,
                  arrival: float | None, quality: float | None) -> Rejection | None:
        """Take in a tip position; the tip is watched whether or not points are collected."""
        number = self._source_of.get(source)
        if number is None:
            number = self._source_of[source] = len(self._source_of)
            self._tell('source', source)
        collection = self.collection
        rejection = collection.add(stamp, position, frame_id, number, arrival, quality)
        x, y, z = position
        if rejection is None:
            self._tell_frame()
            self._tell('point', [collection.last_stroke, number, float(stamp), float(x), float(y),
                                 float(z)])
        else:
            self._tell('rejected', {rejection.value: 1})
        if rejection is None or not rejection.is_of_sample:
            self.touches.tip.add(stamp, (float(x), float(y), float(z)), number, arrival)
        return rejection

    def count_dropped(self, dropped: Mapping[str, int]) -> None:
        """Count points that were refused before they came here, by cause."""
        for cause, count in dropped.items():
            self.collection.counts[cause] = self.collection.counts.get(cause, 0) + count
            self.collection.received += count
        self._tell('rejected', dict(dropped))

    def collect(self, on: bool) -> None:
        """Start a stroke, or end it."""
        if on:
            self.collection.start_stroke()
        else:
            self.collection.end_stroke()
        self._tell('collecting', on)

    def undo(self) -> Stroke | None:
        """Drop the stroke begun last and return it."""
        dropped = self.collection.undo()
        if dropped is not None:
            self.revision += 1
            self._tell('undo', dropped.number)
        return dropped

    def clear(self) -> None:
        """Drop all points, landmarks and verification points; the last good pose stands."""
        self.collection.clear()
        self.touches = LandmarkCapture(self.config.landmarks)
        self._told_frame = None
        self.result = None
        self.revision += 1
        self._tell('clear', None)
        for source in self._source_of:
            self._tell('source', source)
        if self.pose is not None:
            self._tell('pose', [self.pose.frame_id, plain(self.pose.result)])

    def capture_landmark(self, now: float | None) -> Answer:
        """Take the resting tip as the next landmark; what it delivers there is not for the fit."""
        answer, rest = self.touches.capture(now)
        if rest is not None:
            self._withdraw(rest)
            self._tell('landmark', plain(self.touches.landmarks[-1]))
        return answer

    def verify(self, now: float | None) -> Answer:
        """Measure the resting tip against the last good pose; it is never used in the fit."""
        if self.pose is None or self.pose.result.T_bone_tracker is None or self.field is None:
            return Answer(False, 'there is no registration to verify; register first')
        frame_id = self.collection.frame_id
        if frame_id not in (None, self.pose.frame_id):
            return Answer(
                False, f'the tip is in frame "{frame_id}", but the bone was registered in '
                f'"{self.pose.frame_id}"; register again')
        try:
            rest = self.touches.tip.rest(now)
        except InputError as refusal:
            return Answer(False, f'not verified: {refusal.message}')
        if self.pose.holds(rest.source, rest.since):
            return Answer(
                False, 'not verified: the tip has rested here since before the registration, '
                'which was found with this very place; lift it and touch another one')
        answer = self.touches.verify(rest, self.field, self.pose.result.T_bone_tracker,
                                     self.config.limits.verification)
        self._withdraw(rest)
        self._tell('verification', plain(self.touches.verifications[-1]))
        return answer

    def _withdraw(self, rest: StationaryTip) -> None:
        self._tell_frame()
        x, y, z = rest.position.tolist()
        dropped = self.collection.withdraw(rest.source, rest.since, (x, y, z),
                                           2.0 * self.config.landmarks.radius)
        if dropped:
            self.revision += 1
            self._tell('withdrawn', [rest.source, rest.since])
            self._tell('rejected', {Rejection.TOUCHED.value: dropped})

    def register(self, found: AcceptedRegistration) -> RegistrationResult:
        """Take note of a registration, good or not, and return it with what it says of strokes."""
        self.result = result = found.result
        event: dict[str, Any] = {'pose_frame_id': None, 'verifications': None, 'fit': None}
        if result.T_tracker_bone is not None and result.T_bone_tracker is not None:
            serials = self.collection.serials()
            notes = (result.message,
                     interference(found.reports(self.collection.arrays(), serials)),
                     self.touches.odd_one(result.T_tracker_bone))
            self.result = dataclasses.replace(result, message='; '.join(filter(None, notes)))
            self.pose = dataclasses.replace(found, result=self.result)
            assert self.field is not None
            self.touches.verifications = measured_anew(self.touches.verifications, self.field,
                                                       result.T_bone_tracker)
            event = {'pose_frame_id': found.frame_id, 'fit': fit_of(*found.fit(serials)),
                     'verifications': plain(self.touches.verifications)}
        self._tell('registration', {'result': plain(self.result), **event})
        return self.result

    def set_model(self, field: Field) -> bool:
        """Take a bone; return whether it is another one, of which no pose is known."""
        other = self.field is None or self.field.bone_sha256 != field.bone_sha256
        if other:
            self.result = self.pose = None
            self.touches.verifications = []
            self.revision += 1
            if self.field is not None:      # else they were named for the bone to come
                self.touches.landmarks = []
        self.field = field
        self._tell('model', self._model_sha256)
        return other

    def configure(self, config: Config) -> None:
        """Work by these settings; `InputError`, and no change, if what is held forbids it."""
        self.touches.check(config.landmarks)
        wanted = config.points_frame
        if wanted != self.config.points_frame:
            if len(self.collection) or self.touches.landmarks:
                raise InputError(
                    'points or landmarks are held; clear before changing probe.frame_id')
            self.collection.want_frame(wanted)
        self.collection.gate = config.gate
        self.collection.max_points = config.collect.max_points
        self.touches.configure(config.landmarks)
        self.config = config

    @property
    def succeeded(self) -> bool:
        """Whether the last registration gave a pose."""
        return self.result is not None and self.result.success

    @property
    def outdated(self) -> bool:
        """Whether the last good pose was found with points that have been dropped since."""
        return self.pose is not None and self.pose.outdated(self.collection.serials())

    def reports(self) -> tuple[StrokeReport, ...]:
        """Return what each stroke held is worth at the last good pose."""
        if self.pose is None:
            return ()
        key = (self.pose, self.revision)
        if self._reports[0] != key:
            self._reports = key, self.pose.reports(self.collection.arrays(),
                                                   self.collection.serials())
        return self._reports[1]

    def record(self) -> SessionRecord:
        """Return all that is held."""
        serials = self.collection.serials()
        unknown = np.full(len(serials), np.nan)
        residuals, weights = (unknown, unknown) if self.pose is None else self.pose.fit(serials)
        return SessionRecord(
            self._model_sha256, self.collection.frame_id, self.collection.collecting,
            list(self._source_of), self.collection.arrays(), residuals, weights,
            dict(self.collection.counts), list(self.touches.landmarks),
            list(self.touches.verifications), self.result,
            None if self.pose is None else self.pose.result,
            '' if self.pose is None else self.pose.frame_id)

    def restore(self, saved: SessionRecord) -> None:
        """Hold this instead; `InputError` if it does not fit in, and nothing is changed then."""
        self.collection.refill(saved.points, saved.frame_id, saved.rejected)
        self.touches = LandmarkCapture(self.config.landmarks)
        self.touches.landmarks = saved.landmarks
        self.touches.verifications = saved.verifications
        self._source_of = {name: number for number, name in enumerate(saved.source_names)}
        self._told_frame = None
        self.result, self.pose = saved.result, None
        if saved.pose_result is not None:
            in_it = ~np.isnan(saved.weights)
            self.pose = AcceptedRegistration(
                dataclasses.replace(saved.pose_result, residuals_m=saved.residuals[in_it],
                                    weights=saved.weights[in_it]),
                Points(*(column[in_it] for column in saved.points)),
                self.collection.serials()[in_it], saved.pose_frame_id)
        self.revision += 1
        self._tell('session', self.record().to_dict(self.config))

    def _tell_frame(self) -> None:
        if self._told_frame != self.collection.frame_id:
            self._told_frame = self.collection.frame_id
            self._tell('frame', self._told_frame)
