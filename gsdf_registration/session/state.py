# SPDX-License-Identifier: Apache-2.0
"""The state of a session; listeners receive every change, see `session.events`."""

from __future__ import annotations

import dataclasses
import uuid
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.json_values import plain
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points, Rejection, Sample, at_tip
from gsdf_registration.common.tool_pose import TIP_UNKNOWN
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.registration.stroke_report import StrokeReport, interference_message
from gsdf_registration.session.accepted_registration import AcceptedRegistration
from gsdf_registration.session.air import Air, positions
from gsdf_registration.session.collection import Collection, Stroke
from gsdf_registration.session.events import Listener
from gsdf_registration.session.landmark_capture import Answer, CapturedLandmark, LandmarkCapture
from gsdf_registration.session.pose_changes import InitialPose, WithdrawnPose
from gsdf_registration.session.record import SessionRecord, fit_of
from gsdf_registration.session.result_record import result_to_dict
from gsdf_registration.session.stationary_tip import StationaryTip, StationaryTipDetector
from gsdf_registration.session.verification import (
    Verification,
    describe,
    make_verification,
    measured_again,
    surface_distance,
    with_tip,
)


class SessionState:
    """Points, landmarks, verification points and registrations of one bone; not thread-safe."""

    def __init__(self, config: Config, field: Field | None) -> None:
        self.config = config
        self.field = None if field is None else field.for_tip(config.probe.tip_radius)
        self.collection = Collection(config.points_frame)
        self.collection.collecting = config.collect.automatic
        self.tip, self.air = StationaryTipDetector(), Air()
        self.landmarks = LandmarkCapture()
        self.verifications: list[Verification] = []
        self.accepted: AcceptedRegistration | None = None
        self.refusal: RegistrationResult | None = None      # of the last attempt, if refused
        self._accepted_last = False     # whether the last attempt since a clear was accepted
        self.withdrawn: WithdrawnPose | None = None     # the last withdrawal since the last pose
        self.initial_pose: InitialPose | None = None
        self.tools_received = False     # whether poses of a tool arrive, since the last clear
        self._begin()
        # changes whenever points are dropped or replaced, so that followers start again
        self.revision = 0
        self._source_of: dict[str, int] = {}        # number of each topic
        self._reported_frame: str | None = None
        self._listeners: list[Listener] = []
        self._reports: tuple[tuple[Any, ...], tuple[StrokeReport, ...]] = ((), ())
        self._outdated: tuple[tuple[Any, ...], bool] = ((), False)

    def _begin(self) -> None:
        """Give the session a new name; its registrations are numbered from 1."""
        self.session_id, self.registration_id = str(uuid.uuid4()), 0
        self.initial_pose = None

    def listen(self, listener: Listener, from_start: bool = False) -> None:
        """Report every change to ``listener``; ``from_start``: first the whole session."""
        self._listeners.append(listener)
        if from_start:
            listener('session', self.record().to_dict(self.config))
            return
        listener('model', self._model_sha256)
        listener('collecting', self.collection.collecting)
        probe = self.config.probe
        for name, value in (('tip', probe.tip), ('tip_radius', probe.tip_radius),
                            ('tip_error', probe.tip_error)):
            if value:
                listener(name, value)
        for topic in self._source_of:
            listener('source', topic)
        self._reported_frame = None

    def stop_listening(self, listener: Listener) -> None:
        """Report no further changes to ``listener``."""
        self._listeners.remove(listener)

    def _report(self, event: str, value: Any) -> None:
        for listener in self._listeners:
            listener(event, value)

    @property
    def _model_sha256(self) -> str | None:
        return None if self.field is None else self.field.bone_sha256

    def add(self, sample: Sample) -> Rejection | None:
        """Add a tip position; it is used for landmarks whether or not points are collected."""
        source = self._source_of.get(sample.topic)
        if source is None:
            source = self._source_of[sample.topic] = len(self._source_of)
            self._report('source', sample.topic)
        if sample.tool is not None:
            self.tools_received = True
            sample = at_tip(sample, self.config.probe.tip)
        rejection = self.collection.add(sample, source, self.config)
        if rejection is None:
            self._report_frame()
            self._report('point', [self.collection.last_stroke, source, sample.stamp,
                                   *sample.position, *(sample.tool or ())])
        else:
            self._report('rejected', {rejection.value: 1})
        for row in self.air.add(sample, source, rejection, self.config.gate):
            self._report('air', list(row))
        if rejection is None or not rejection.invalidates_sample:
            self.tip.add(sample, source, self.config.landmarks)
        return rejection

    def count_rejected(self, counts: Mapping[str, int]) -> None:
        """Count samples that were rejected before they were added, by cause."""
        for cause, count in counts.items():
            self.collection.counts[cause] = self.collection.counts.get(cause, 0) + count
            self.collection.received += count
        self._report('rejected', dict(counts))

    def collect(self, on: bool) -> None:
        """Start a stroke, or end it."""
        if on:
            self.collection.start_stroke()
        else:
            self.collection.end_stroke()
        self._report('collecting', on)

    def undo(self) -> Stroke | None:
        """Drop the stroke started last and return it; None if there is none."""
        return self._dropped(self.collection.undo())

    def drop_stroke(self, number: int) -> Stroke | None:
        """Drop a stroke and return it; None if there is no such stroke."""
        return self._dropped(self.collection.drop_stroke(number))

    def _dropped(self, stroke: Stroke | None) -> Stroke | None:
        if stroke is not None:
            self.revision += 1
            self._report('undo', stroke.number)
            self._report('rejected', {Rejection.UNDONE.value: stroke.points})
        return stroke

    def clear(self, reason: str | None = None) -> None:
        """
        Drop all points, landmarks and verification points, and withdraw the pose.

        ``reason``: why, if the operator did not ask for it: the clock of the points went back.
        """
        if reason is None:
            self._drop_pose(Withdrawal.CLEARED, 'the session was cleared: collect and register')
        else:
            self._drop_pose(Withdrawal.CLOCK_JUMPED, f'{reason}: collect and register again')
        self.collection.clear(self.config.points_frame)
        self.tip, self.landmarks = StationaryTipDetector(), LandmarkCapture()
        self.air, self.verifications = Air(), []
        self.tools_received = False
        self._reported_frame = None
        self.refusal = None
        self._begin()
        self.revision += 1
        self._report('clear', reason)
        for topic in self._source_of:
            self._report('source', topic)

    def withdraw_pose(self, reason: Withdrawal, message: str) -> None:
        """Withdraw the accepted registration, if there is one; the points stay."""
        if self.accepted is not None:
            self._drop_pose(reason, message)
            self._report('no_pose', reason.value)

    def _drop_pose(self, reason: Withdrawal, message: str) -> None:
        if self.accepted is not None:
            self.withdrawn = WithdrawnPose(reason, message, self.session_id, self.registration_id,
                                           self.accepted.frame_id)
        self.accepted, self._accepted_last = None, False

    def set_initial_pose(self, T_tracker_bone: Array, frame_id: str) -> Answer:
        """Search here first until a registration is accepted or the session is cleared."""
        given = InitialPose(T_tracker_bone, frame_id)
        if self.collection.frame_id and not given.applies_to(self.collection.frame_id):
            return Answer(False, f'the initial pose is rejected: it is in frame "{frame_id}", but '
                          f'the points are in "{self.collection.frame_id}"')
        self.initial_pose = given
        return Answer(True, 'the initial pose is the first guess until a registration is accepted')

    @property
    def guess(self) -> Array | None:
        """The initial pose T_tracker_bone (4, 4), if it is in the frame of the points."""
        initial = self.initial_pose
        if initial is None or not initial.applies_to(self.collection.frame_id):
            return None
        return initial.T_tracker_bone

    @property
    def unused_initial_pose(self) -> str:
        """Return why the initial pose does not apply to the points; empty if it does."""
        initial, points_frame = self.initial_pose, self.collection.frame_id
        if initial is None or not points_frame or initial.applies_to(points_frame):
            return ''
        return (f'the initial pose is not used: it is in frame "{initial.frame_id}", but the '
                f'points are in "{points_frame}"')

    def capture_landmark(self, now: float | None) -> Answer:
        """Capture the stationary tip as the next landmark; its points are not used in the fit."""
        answer, tip = self.landmarks.capture(self.tip, self.config.landmarks, now,
                                             self.tip_unknown)
        if tip is not None:
            self._withdraw(tip)
            name, _ = answer.detail
            self._report('landmark', plain(next(each for each in self.landmarks.captured
                                                if each.name == name)))
        return answer

    def add_joint_centre(self, landmark: CapturedLandmark) -> None:
        """Store the centre of a joint as a landmark."""
        self.landmarks.add(landmark, self.config.landmarks)
        self._report('landmark', plain(landmark))

    def verify(self, now: float | None) -> Answer:
        """Measure the stationary tip against the accepted registration."""
        accepted, limit = self.accepted, self.config.limits.verification
        if accepted is None or accepted.result.T_bone_tracker is None or self.field is None:
            return Answer(False, 'there is no registration to verify; register first')
        frame_id = self.collection.frame_id
        if frame_id not in (None, accepted.frame_id):
            return Answer(
                False, f'the tip is in frame "{frame_id}", but the bone was registered in '
                f'"{accepted.frame_id}"; register again')
        try:
            tip = self.tip.detect(self.config.landmarks, now)
        except InputError as error:
            return Answer(False, f'not verified: {error.message}')
        if tip.tool is not None and not self.config.probe.tip:
            return Answer(False, f'not verified: {TIP_UNKNOWN}')
        if accepted.uses(tip.source, tip.since):
            return Answer(
                False, 'not verified: the tip has not moved since before the registration, which '
                'used the points measured here; lift the probe and touch another place')
        distance = surface_distance(self.field, accepted.result.T_bone_tracker, tip.position)
        latest = make_verification(tip, distance, self.verifications)
        message = describe(latest, self.verifications, limit)
        self.verifications.append(latest)
        self._withdraw(tip)
        self._report('verification', plain(latest))
        if (latest.moved_m or 0.0) > limit:
            self.withdraw_pose(Withdrawal.ARRAY_DISPLACED, (
                f'the pose is withdrawn because checkpoint {latest.checkpoint} has moved: clear '
                'and collect again; if another place was touched, register again'))
            message += ' The pose is withdrawn'
        return Answer(latest.within(limit), message, latest)

    def _withdraw(self, tip: StationaryTip) -> None:
        """Drop the points of a stationary tip; they are not used in the fit."""
        self._report_frame()
        x, y, z = tip.position.tolist()
        dropped = self.collection.withdraw(tip.source, tip.since, (x, y, z),
                                           2.0 * self.config.landmarks.radius)
        if dropped:
            self.revision += 1
            self._report('withdrawn', [tip.source, tip.since])
            self._report('rejected', {Rejection.TOUCHED.value: dropped})

    def accept(self, found: AcceptedRegistration) -> RegistrationResult:
        """Store a successful registration; return its result with remarks on the strokes."""
        result, serials = found.result, self.collection.serials()
        assert self.field is not None
        assert result.T_tracker_bone is not None and result.T_bone_tracker is not None
        remarks = (result.message,
                   interference_message(found.reports(self.collection.points(), serials)),
                   self.landmarks.misplaced(result.T_tracker_bone))
        result = dataclasses.replace(result, message='; '.join(filter(None, remarks)))
        self.accepted = dataclasses.replace(found, result=result)
        self.refusal, self._accepted_last = None, True
        self.withdrawn = self.initial_pose = None
        self.registration_id += 1
        assert result.T_bone_tracker is not None
        self.verifications = measured_again(self.verifications, self.field, result.T_bone_tracker)
        self._report('registration', {
            'result': result_to_dict(result), 'pose_frame_id': found.frame_id,
            'verifications': plain(self.verifications), 'fit': fit_of(*found.fit(serials))})
        return result

    def refuse(self, result: RegistrationResult) -> None:
        """Store a refusal; the accepted registration stays."""
        self.refusal = result
        self._report('registration', {'result': result_to_dict(result), 'pose_frame_id': None,
                                      'verifications': None, 'fit': None})

    def set_model(self, field: Field) -> bool:
        """Set the bone model; return whether it is another one, which has no registration yet."""
        other = self.field is None or self.field.bone_sha256 != field.bone_sha256
        if other:
            self._drop_pose(Withdrawal.MODEL_CHANGED,
                            'another bone model was loaded: register the bone again')
            self.refusal = self.initial_pose = None
            self.verifications = []
            self.revision += 1
            if self.field is not None:      # landmarks captured before the first model belong to it
                self.landmarks = LandmarkCapture()
        self.field = field.for_tip(self.config.probe.tip_radius)
        self._report('model', self._model_sha256)
        return other

    def configure(self, config: Config) -> None:
        """Apply new settings; `InputError`, and no change, if the session does not permit them."""
        self.landmarks.check(config.landmarks, self.config.landmarks)
        if config.points_frame != self.config.points_frame:
            if len(self.collection) or self.landmarks.captured:
                raise InputError('the session contains points or landmarks; clear before changing '
                                 'probe.frame_id')
            self.collection.expect_frame(config.points_frame)
        before, self.config = self.config, config
        if config.landmarks.sigmas != before.landmarks.sigmas:
            self.landmarks.apply_sigmas(config.landmarks)
        if config.probe.tip != before.probe.tip:
            self._apply_tip(config.probe.tip)
        if config.probe.tip_radius != before.probe.tip_radius:
            self._apply_tip_radius(config.probe.tip_radius)
        if config.probe.tip_error != before.probe.tip_error:
            self._report('tip_error', config.probe.tip_error)

    def _apply_tip_radius(self, radius: float) -> None:
        """Use another radius of the ball tip; the points, which are its centres, stay."""
        if self.field is not None:
            self.field = self.field.for_tip(radius)
        self.revision += 1      # whatever was computed from the points is outdated
        self.withdraw_pose(Withdrawal.TIP_CHANGED, 'the pose is withdrawn because probe.tip_radius '
                           'was changed: register again')
        self._report('tip_radius', radius)

    def _apply_tip(self, tip: list[float]) -> None:
        """Move everything that was touched with a tool to this tip, (3,) m or empty."""
        if self.collection.has_tools:
            self.collection.apply_tip(tip)
            self.revision += 1
        self.landmarks.apply_tip(tip)
        self.air.apply_tip(tip)
        self.tip = StationaryTipDetector()
        self.verifications = with_tip(self.verifications, tip)
        accepted = self.accepted
        if accepted is not None and accepted.uses_tools:
            self.withdraw_pose(Withdrawal.TIP_CHANGED, 'the pose is withdrawn because the tip of '
                               'the probe was calibrated or set again: register again')
        self._report('tip', tip)

    def air_positions(self) -> Callable[[], Array]:
        """Return a function that computes `air.positions`, with copies, as that takes a while."""
        config = self.config
        if not config.collect.air:
            return lambda: np.empty((0, 3))
        return partial(positions, list(self.air.rows), self.collection.points(), config.probe.tip,
                       config.probe.shaft)

    @property
    def tip_unknown(self) -> bool:
        """Whether poses of a tool arrive, or were collected, and its tip is not known."""
        return self.tools_received and not self.config.probe.tip

    @property
    def tip_missing(self) -> bool:
        """Whether anything was touched with a tool whose tip is not known."""
        return self.tip_unknown and (self.collection.has_tools or self.landmarks.has_tools)

    @property
    def result(self) -> RegistrationResult | None:
        """Result of the last attempt since the last clear; None if there was none."""
        if self.refusal is not None:
            return self.refusal
        return self.accepted.result if self.accepted is not None and self._accepted_last else None

    @property
    def succeeded(self) -> bool:
        """Whether the last attempt was accepted."""
        return self.result is not None and self.result.success

    @property
    def outdated(self) -> bool:
        """Whether points of the accepted registration have been dropped since."""
        if self.accepted is None:
            return False
        key = (self.accepted, self.revision)    # points are dropped only with a new revision
        if self._outdated[0] != key:
            self._outdated = key, self.accepted.outdated(self.collection.serials())
        return self._outdated[1]

    def reports(self) -> tuple[StrokeReport, ...]:
        """Return a report of each stroke at the accepted registration."""
        if self.accepted is None:
            return ()
        key = (self.accepted, self.revision)
        if self._reports[0] != key:
            self._reports = key, self.accepted.reports(self.collection.points(),
                                                       self.collection.serials())
        return self._reports[1]

    def record(self) -> SessionRecord:
        """Return the whole state."""
        serials, accepted = self.collection.serials(), self.accepted
        unknown = np.full(len(serials), np.nan)
        residuals, weights = (unknown, unknown) if accepted is None else accepted.fit(serials)
        return SessionRecord(
            self._model_sha256, self.collection.frame_id, self.collection.collecting,
            list(self._source_of), self.collection.points(), residuals, weights,
            dict(self.collection.counts), list(self.landmarks.captured),
            list(self.verifications), self.result,
            None if accepted is None else accepted.result,
            '' if accepted is None else accepted.frame_id, self.config.probe.tip,
            list(self.air.rows), self.config.probe.tip_radius, self.config.probe.tip_error)

    def restore(self, saved: SessionRecord) -> None:
        """
        Replace the state by a saved one; `InputError`, and no change, if it does not fit.

        If ``probe.tip`` is not set, that of the saved session is used from now on, with its error.
        """
        config = self.config if self.config.probe.tip or not saved.tip else self.config.replaced(
            {'probe.tip': saved.tip, 'probe.tip_error': saved.tip_error})
        self.collection.restore(saved.points, saved.frame_id, saved.rejected, self.config)
        self.tip, self.landmarks = StationaryTipDetector(), LandmarkCapture()
        for landmark in saved.landmarks:    # a journal has them in the order captured
            self.landmarks.add(landmark, self.config.landmarks)
        self.tools_received |= self.collection.has_tools or self.landmarks.has_tools
        self.air.restore(saved.air)
        self.verifications = saved.verifications
        self._source_of = {name: number for number, name in enumerate(saved.source_names)}
        self._reported_frame = None
        self._drop_pose(Withdrawal.SESSION_LOADED,
                        'a session without a registration was loaded: register the bone')
        self._begin()
        if saved.pose_result is not None:
            self.withdrawn, self.registration_id = None, 1
            known = ~np.isnan(saved.weights)
            count = int(known.sum())
            # mostly the first ones: views of them take no memory
            registered = slice(count) if known[:count].all() else known
            self.accepted = AcceptedRegistration(
                dataclasses.replace(saved.pose_result, residuals_m=saved.residuals[registered],
                                    weights=saved.weights[registered]),
                Points(*(column[registered] for column in self.collection.points())),
                self.collection.serials()[registered], saved.pose_frame_id)
        last = saved.result
        self.refusal = last if last is not None and not last.success else None
        self._accepted_last = last is not None and last.success
        self.config = config
        if config.probe.tip != saved.tip:
            self._apply_tip(config.probe.tip)
        if config.probe.tip_radius != saved.tip_radius:
            self.withdraw_pose(Withdrawal.TIP_CHANGED, 'the pose is withdrawn because it was found '
                               f'with probe.tip_radius {saved.tip_radius:g} m, which is now '
                               f'{config.probe.tip_radius:g} m: register again')
        self.revision += 1
        self._report('session', self.record().to_dict(self.config))

    def _report_frame(self) -> None:
        if self._reported_frame != self.collection.frame_id:
            self._reported_frame = self.collection.frame_id
            self._report('frame', self._reported_frame)
