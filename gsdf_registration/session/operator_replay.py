# SPDX-License-Identifier: Apache-2.0
"""The requests of an operator, carried out again on a session in a replay."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gsdf_registration.common.config import Config, UnmatchedPlaces
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.operator_event import UNKNOWN, OperatorEvent
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.session.calibration import CalibrationKind
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.session import Session
from gsdf_registration.tracking.pivot import FixedPoint
from gsdf_registration.tracking.point_transformer import PointTransformer

# settings of files and topics, which a replay has from its own command line
FOREIGN = ('model.path', 'model.unit', 'model.label', 'model.body', 'session.', 'probe.topics')

Settle = Callable[[Config], Config]


def recorded_config(settings: Mapping[str, Any], settle: Settle) -> Config:
    """
    Return the settings that a node used, by dotted name, changed by ``settle``.

    Raises
    ------
    InputError
        If the settings do not fit together, or come from another version.

    """
    return settle(Config().replaced({name: value for name, value in settings.items()
                                     if not name.startswith(FOREIGN)}))


class OperatorReplay:
    """
    Carries out recorded requests.

    Parameters
    ----------
    session : Session
    transformer : PointTransformer
        Through which the session receives samples.
    model_sha256 : str
        Of the bone of the replay.
    settle : function
        Returns the settings to use in place of those of the node.
    settings : dict
        Of the node, by dotted name, before the first event.
    landmarks, T_tracker_bone : optional
        Of every registration, in place of those of the node.

    Attributes
    ----------
    receiving, active : bool
        Whether the node received the poses of the reference array, and used samples.

    """

    def __init__(self, session: Session, transformer: PointTransformer, model_sha256: str,
                 settle: Settle, settings: Mapping[str, Any],
                 landmarks: Landmarks | None = None, T_tracker_bone: Array | None = None) -> None:
        self.receiving = self.active = False
        self._other_model = False
        self._session, self._transformer, self._sha256 = session, transformer, model_sha256
        self._settle = settle
        self._landmarks, self._T = landmarks, T_tracker_bone
        self._settings = dict(settings)
        self._difference = ''       # sentence on the first one since the session began

    @property
    def notes(self) -> list[str]:
        """Sentences on what differs from the node."""
        model = 'the node used another bone model than the replay' if self._other_model else ''
        return [note for note in (model, self._difference) if note]

    def apply(self, event: OperatorEvent) -> None:
        """Carry out one request; one that the node did not carry out changes nothing."""
        if not event.performed:
            return
        if event.begins_session:
            self._difference = ''
        else:
            self._compare_points(event)
        try:
            answer = self._requests(event)
        except InputError as error:
            answer = Answer(False, error.message)
        if answer is not None and answer.success != event.success:
            self._differ(f'the node answered "{event.message}", the replay "{answer.message}"',
                         event)

    def _requests(self, event: OperatorEvent) -> Answer | None:
        """Carry out a request; return the answer if it can be compared."""
        session, request, name = self._session, event.request, event.name
        if name == 'collect':
            return session.collect(bool(request['data']))
        if name in ('undo', 'drop_stroke'):
            return self._drop(event)
        if name == 'clear':
            self._transformer.clear()
            return session.clear()
        if name == 'capture_landmark':
            return session.capture_landmark()
        if name == 'verify':
            return session.verify()
        if name == 'register':
            result = self._register(request.get('T_tracker_bone'))
            return Answer(result.success, f'{result.reason}: {result.message}')
        if name in [kind.value for kind in CalibrationKind]:
            return self._calibrate(event)
        if name == 'initial_pose':
            answer = session.set_initial_pose(np.array(request['T_tracker_bone']),
                                              request['frame_id'])
            return None if event.follow_up == 'unknown' else answer     # of the node
        self._change(event)
        return None

    def _change(self, event: OperatorEvent) -> None:
        """Follow a change of the node's state or settings."""
        session, request = self._session, event.request
        if event.name == 'parameters':
            self._settings |= request
            # names and positions may have been set by one request after the other
            with contextlib.suppress(UnmatchedPlaces):
                session.configure(recorded_config(self._settings, self._settle))
            if 'probe.topics' in request:       # new subscriptions
                self._transformer.finish()
                self._transformer.reset()
        elif event.name in ('configure', 'activate', 'deactivate', 'model'):
            self.receiving = True
            self._check_model(request.get('model_sha256'))
            self._settings = dict(request.get('settings', self._settings))
            if event.name == 'configure':       # a new session and new subscriptions
                self._transformer.reset()
                session.clear()
                if event.kept not in (0, UNKNOWN):
                    self._differ(f'the node resumed a session with {event.kept} points, which are '
                                 'not in the recording', event)
            session.configure(recorded_config(self._settings, self._settle))
            if event.name == 'activate':
                self.active = True
                session.activate()
            elif event.name == 'deactivate':
                self.active = False
                session.deactivate()
        elif event.name == 'load':
            self._differ('the node loaded a session, which is not in the recording', event)
        elif event.name != 'save':
            self._differ('this event is not known', event)

    def _drop(self, event: OperatorEvent) -> Answer:
        session, before = self._session, self._session.status().outdated
        answer = session.undo() if event.name == 'undo' else session.drop_stroke(
            int(event.request['stroke']))
        follow_up = event.follow_up
        if follow_up == 'unknown' and session.status().outdated and not before:
            follow_up = 'registered' if self._register(None).success else 'withdrawn'
        elif follow_up in ('registered', 'refused'):
            found = self._register(None)
            if found.success != (follow_up == 'registered'):
                self._differ(f'the node answered "{event.message}", the replay "{found.message}"',
                             event)
        if follow_up in ('refused', 'withdrawn'):
            session.withdraw_pose(Withdrawal.POINTS_DROPPED, event.message)
        return answer

    def _calibrate(self, event: OperatorEvent) -> Answer:
        """Start or end a calibration; the node sets the tip, which may not be recorded."""
        session = self._session
        answer = session.calibrations.call(CalibrationKind(event.name))
        found = answer.detail
        if event.follow_up == 'unknown' and isinstance(found, FixedPoint) and answer.success:
            assert found.point is not None
            self._settings |= {'probe.tip': found.point.tolist(),
                               'probe.tip_error': found.rms_error}
            session.configure(recorded_config(self._settings, self._settle))
        return answer

    def _register(self, T_tracker_bone: Any) -> RegistrationResult:
        initial = None if T_tracker_bone is None else np.array(T_tracker_bone)
        return self._session.register(self._landmarks, initial if self._T is None else self._T)

    def _check_model(self, model_sha256: str | None) -> None:
        if model_sha256 not in (None, self._sha256):
            self._other_model = True

    def _compare_points(self, event: OperatorEvent) -> None:
        kept = self._session.kept
        if event.kept not in (kept, UNKNOWN):
            self._differ(f'the node had {event.kept} points, the replay has {kept}', event)

    def _differ(self, what: str, event: OperatorEvent) -> None:
        """Keep the first difference in the session; what follows it may differ as a result."""
        if not self._difference:
            self._difference = (f'not replayed exactly, from event {event.number} ({event.name}) '
                                f'on: {what}')
