# SPDX-License-Identifier: Apache-2.0
"""The status message combines the session with the live registration."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import LandmarkFit, Reason, RegistrationResult
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.live import LiveStatus
from gsdf_registration.registration.stroke_report import StrokeReport
from gsdf_registration.session import Session
from gsdf_registration.session.pose_changes import WithdrawnPose
from gsdf_registration.session.status import Status
from gsdf_registration.session.status_message import status_message
from gsdf_registration.session.status_values import (
    combined_status,
    not_active,
    pose_kept,
    sentence,
)
from msg_adapters.messages import DiagnosticStatus, Time
from msg_adapters.ros import with_stamp

READY = LiveStatus(ready=True, message='enough points: register now')
FEW = LiveStatus(message='drag the probe', reason=Reason.TOO_FEW_POINTS)
LOOSE = LiveStatus(message='touch the bone', reason=Reason.UNDER_CONSTRAINED)
ACCEPTED = RegistrationResult(Reason.CONVERGED, 'registered')


def status(**values: object) -> Status:
    """Return the status of a new session with a bone, with other values."""
    known = vars(Session(Config()).status()) | {'state': 'collecting', 'message': 'collecting'}
    return Status(**known | values)


def test_is_ready_once_the_points_suffice() -> None:
    combined = combined_status(status(notice='resumed'), READY)
    assert combined.state == 'ready'
    assert combined.message == 'enough points: register now; resumed'


def test_warns_that_collecting_has_stopped_also_when_ready() -> None:
    full = status(full=True, message='collecting has stopped')
    combined = combined_status(full, READY)
    assert combined.state == 'ready'
    assert combined.message == 'collecting has stopped; enough points: register now'
    for shown in (full, combined):
        message = status_message(shown, READY, '/registration')
        assert message.level == DiagnosticStatus.WARN
        assert message.message.startswith('collecting has stopped')
    registered = status(full=True, state='registered', pose_result=ACCEPTED)
    assert status_message(registered, READY, '/registration').level == DiagnosticStatus.OK


@pytest.mark.parametrize('state', ['no_model', 'solving', 'registered'])
def test_other_states_come_before_ready(state: str) -> None:
    before = status(state=state)
    assert combined_status(before, READY) == before


def test_is_not_ready_while_a_registration_is_accepted() -> None:
    combined = combined_status(status(pose_result=ACCEPTED), READY)
    assert (combined.state, combined.message) == ('collecting', 'collecting')
    assert combined_status(status(pose_result=ACCEPTED, outdated=True), READY).state == 'ready'


def test_appends_what_is_missing() -> None:
    assert combined_status(status(), LOOSE).message == 'collecting; touch the bone'
    assert combined_status(status(), FEW).message == 'collecting; drag the probe'


def test_asks_for_landmarks_before_strokes() -> None:
    landmarks_left = status(remaining_landmarks=('head',))
    assert combined_status(landmarks_left, FEW).message == 'collecting'
    assert combined_status(landmarks_left, LOOSE).message == 'collecting; touch the bone'


def test_message_has_the_level_of_the_state_and_values_of_both() -> None:
    live = LiveStatus(used=7, reason=Reason.AMBIGUOUS, touch_next='touch the rim',
                      predicted_tre_m={'rms': 0.001},
                      stroke_reports=(StrokeReport(3, 20, 1.0, 1e-4, False),))
    message = status_message(status(state='refused', pose_result=ACCEPTED), live, '/registration')
    values = {pair.key: pair.value for pair in message.values}
    assert message.message.endswith('; the accepted registration is kept')
    assert (values['state'], values['live.points'], values['live.reason']) == (
        'refused', '7', 'ambiguous')
    assert values['touch_next'] == 'touch the rim'
    assert values['live.predicted_tre_m.rms'] == '0.001000'
    assert values['stroke.3'].startswith('stroke 3: 20 points')
    level = message.level if isinstance(message.level, int) else message.level[0]
    assert level == 1       # WARN


def test_joins_parts_that_are_not_empty() -> None:
    assert sentence('a', '', 'b') == 'a; b'
    assert pose_kept(status()) == ''


def test_a_withdrawn_pose_is_in_the_values() -> None:
    pose = WithdrawnPose(Withdrawal.ARRAY_DISPLACED, 'clear', 'a1b2', 3, 'tracker')
    values = {pair.key: pair.value
              for pair in status_message(status(withdrawn=pose), FEW, 'node').values}
    assert values['withdrawn'] == 'array_displaced' and values['pose'] == 'none'


def test_a_node_that_is_not_active_has_no_pose() -> None:
    shown = not_active(status(pose_result=ACCEPTED, state='registered', session_id='a1b2',
                              registration_id=3, pose_frame_id='tracker'))
    assert shown.pose_result is None and shown.state == 'idle'
    assert shown.withdrawn == (Withdrawal.DEACTIVATED, '', 'a1b2', 3, 'tracker')
    fresh = status()
    assert not_active(fresh) is fresh


def test_a_notice_to_act_on_is_a_warning() -> None:
    for warning, level in ((False, DiagnosticStatus.OK), (True, DiagnosticStatus.WARN)):
        assert status_message(status(warning=warning), FEW, 'node').level == level


def test_the_stamp_is_the_first_value() -> None:
    message = status_message(status(), FEW, 'node')
    stamped = with_stamp(message, Time(sec=12, nanosec=5))
    assert (stamped.values[0].key, stamped.values[0].value) == ('stamp', '12.000000005')
    assert stamped.values[1:] == message.values and stamped.message == message.message


def test_landmarks_that_are_measurements_are_reported_against_their_standard_deviation() -> None:
    fits = (LandmarkFit('hip_centre', True, 0.002, 0.0031, 1.2),
            LandmarkFit('tip', False, 0.001, 0.02, 11.0))
    accepted = replace(ACCEPTED, landmarks=fits)
    values = {value.key: value.value for value in status_message(
        status(pose_result=accepted), LiveStatus(), 'node').values}
    assert values['landmark.hip_centre'] == (
        '3.1 mm from its place, 1.2 standard deviations from where it is expected without it')
    assert values['landmark.tip'].endswith('without it: not used')
