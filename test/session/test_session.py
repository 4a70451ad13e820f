# SPDX-License-Identifier: Apache-2.0
"""Strokes, registrations and settings of a session, and what its status says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from session_fixtures import (
    CONFIG,
    LANDMARKS,
    RATE,
    T_TRACKER_BONE,
    bone,
    registered,
    sample,
    send,
    surface_points,
    with_landmarks,
)

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.rigid import transform
from gsdf_registration.common.samples import Rejection
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.session import Answer, Session
from gsdf_registration.session import session as session_module


def test_landmarks_points_registration(field: Field) -> None:
    session = with_landmarks(field)
    send(session, surface_points(field), start=100.0)
    result = session.register()
    assert result.success
    error = transform(result.T_tracker_bone, LANDMARKS) - transform(T_TRACKER_BONE, LANDMARKS)
    assert np.abs(error).max() < 2e-4
    status = session.status()
    assert (status.state, status.reason, status.pose_frame_id) == ('registered', Reason.CONVERGED,
                                                                   'cam')
    assert status.result is status.pose_result is result
    assert result.received == status.received == 450
    assert len(session.registered_points().stamps) == len(result.residuals_m) == status.kept


def test_status_names_the_state_and_the_next_step(field: Field) -> None:
    session = Session(CONFIG)
    assert session.status().state == 'no_model' and 'model.path' in session.status().message
    session.set_model(field)
    assert session.status().state == 'collecting'
    assert session.status(
    ).message == 'collecting; 0 points in 0 strokes; next landmark is "x"'
    session.collect(False)
    assert session.status().state == 'idle'
    session.register()
    assert session.status().state == 'refused' and session.status().message.startswith(
        'too few points: 0')
    session.collect(True)
    assert session.status().state == 'collecting'


def test_a_refusal_is_shown_until_more_points_are_added(field: Field) -> None:
    session = Session(CONFIG, field)
    session.register()
    send(session, surface_points(field, 29))
    assert session.status().state == 'refused'
    send(session, surface_points(field, 1), start=100.0)
    assert session.status().message == (
        'collecting; 30 points in 30 strokes; next landmark is "x"')


def test_a_registration_is_shown_until_its_points_are_undone(field: Field) -> None:
    session = registered(field)
    send(session, surface_points(field, 40), start=1000.0)
    assert session.undo().success
    assert session.status().state == 'registered'
    for _ in range(40):
        session.undo()
    assert session.status().state == 'collecting' and session.status().outdated


def test_automatic_collection_can_be_off(field: Field) -> None:
    session = Session(Config.from_flat({'collect.automatic': False}), field)
    assert session.status().state == 'idle'
    assert session.add(sample(0.0, (0.0, 0.0, 0.0))) is Rejection.NOT_COLLECTING
    assert session.collect(True).success
    assert session.add(sample(1.0, (0.0, 0.0, 0.0))) is None


def test_refuses_to_register_without_a_model() -> None:
    assert Session(CONFIG).register().reason is Reason.NO_MODEL


def test_registers_from_a_start_pose_or_landmarks(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field))
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    assert session.register(landmarks=Landmarks.of(
        LANDMARKS, transform(T_TRACKER_BONE, LANDMARKS))).success


def test_an_initial_pose_is_the_first_guess(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    session, given = Session(CONFIG, field), []
    monkeypatch.setattr(session_module, 'register', lambda *_, T_tracker_bone, **__: (
        given.append(T_tracker_bone), RegistrationResult.refused(Reason.AMBIGUOUS, 'no'))[1])
    assert not session.initial_pose() and session.set_initial_pose(T_TRACKER_BONE).success
    session.register()
    session.register(T_tracker_bone=np.eye(4))
    assert given[0] is session.initial_pose() is T_TRACKER_BONE and given[1] is not T_TRACKER_BONE
    send(session, surface_points(field, 2))
    assert not session.set_initial_pose(T_TRACKER_BONE, 'map').success
    assert session.status().warning and 'in frame "map"' in session.status().message
    assert session.set_initial_pose(T_TRACKER_BONE, 'cam').success      # corrected
    assert not session.status().warning and 'in frame "map"' not in session.status().message


def test_reports_an_initial_pose_in_another_frame_than_the_first_point(field: Field) -> None:
    session = Session(CONFIG, field)
    assert session.set_initial_pose(T_TRACKER_BONE, 'map').success
    send(session, surface_points(field, 2))
    session.register()
    assert session.status().message.endswith(
        'the initial pose is not used: it is in frame "map", but the points are in "cam"')


def test_the_stamp_of_the_pose_is_that_of_the_newest_point(field: Field) -> None:
    session = registered(field)
    assert session.status().pose_stamp == session.points().stamps[-1] == 399.0


def test_a_refusal_keeps_the_accepted_registration(field: Field) -> None:
    session = registered(field)
    good = session.status().pose_result
    session.configure(session.config.replaced({'limits.min_points': 1000}))
    assert session.register().reason is Reason.TOO_FEW_POINTS
    status = session.status()
    assert status.state == 'refused' and status.pose_result is good and status.result is not good


def test_undo_drops_one_stroke_after_another(field: Field) -> None:
    session = Session(CONFIG, field)
    line = np.linspace([0.0, 0.0, 0.0], [0.1, 0.0, 0.0], 100)
    for stroke in range(3):
        assert session.collect(True).success
        for i, point in enumerate(line):
            session.add(sample(10.0 * stroke + i / RATE, point))
        session.collect(False)
    assert (session.status().kept, session.status().strokes) == (300, 3)
    answer = session.undo()
    assert answer.success
    assert answer.message == 'dropped the last stroke, 100 points; 200 points in 2 strokes left'
    session.undo(), session.undo()
    assert not session.undo().success
    assert session.status().kept == 0


def test_drops_any_stroke(field: Field) -> None:
    session = Session(CONFIG, field)
    events: list[Any] = []
    line = np.linspace([0.0, 0.0, 0.0], [0.1, 0.0, 0.0], 100)
    for stroke in range(4):
        session.collect(True)
        for i, point in enumerate(line):
            session.add(sample(10.0 * stroke + i / RATE, point))
    session.listen(lambda *event: events.append(event))
    assert session.drop_stroke(3).message == (
        'dropped stroke 3, 100 points; 300 points in 3 strokes left')
    assert events[-2:] == [('undo', 3), ('rejected', {'undone': 100})]
    assert np.unique(session.points().strokes).tolist() == [1, 2, 4]
    assert session.drop_stroke(3) == Answer(
        False, 'there is no stroke 3; the strokes are 1, 2, 4')
    assert session.undo().success and session.drop_stroke(1).success
    assert np.unique(session.points().strokes).tolist() == [2]
    assert session.drop_stroke(2).message.endswith('0 points in 0 strokes left')
    assert session.drop_stroke(2) == Answer(False, 'there is no stroke 2; there are no strokes')


def test_a_registration_is_outdated_when_a_stroke_of_it_is_dropped(field: Field) -> None:
    session = registered(field)
    assert not session.drop_stroke(1000).success and not session.status().outdated
    assert session.drop_stroke(30).success and session.status().outdated


def test_points_after_a_dropped_stroke_start_another(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field, 5))
    numbers = np.unique(session.points().strokes).tolist()
    assert session.drop_stroke(numbers[-1]).success     # the one that is being collected
    send(session, surface_points(field, 1), start=0.5 + len(numbers))
    assert session.points().strokes[-1] == numbers[-1] + 1


def test_clear_drops_points_and_landmarks(field: Field) -> None:
    session = registered(field)
    before = session.status()
    assert session.clear().message.endswith('verification points; the pose is withdrawn')
    status = session.status()
    assert (status.received, status.kept, status.landmarks, status.state) == (0, 0, 0, 'collecting')
    assert status.result is status.pose_result is None and status.captured == ()
    assert status.withdrawn.registration_id == before.registration_id == 1
    assert status.withdrawn.session_id == before.session_id != status.session_id
    assert 'withdrawn' not in session.clear().message


def test_undo_drops_the_parts_of_a_split_stroke(field: Field) -> None:
    session = Session(CONFIG, field)
    line = np.linspace([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], 80)
    for stroke in range(2):
        session.collect(True)
        for i, point in enumerate(line):
            session.add(sample(100.0 * stroke + i / RATE, point))
    for i, point in enumerate(line):        # after a silence
        session.add(sample(150.0 + i / RATE, point))
    assert session.undo().message == (
        'dropped the last stroke, 80 points after a silence; undo again to drop the stroke before '
        'the silence too; 160 points in 2 strokes left')
    assert session.undo().message == (
        'dropped the last stroke, 80 points; 80 points in 1 stroke left')
    assert session.undo().success and not session.undo().success


def test_a_registration_is_outdated_when_its_points_are_dropped(field: Field) -> None:
    session = Session(CONFIG, field)
    assert not session.status().outdated
    send(session, surface_points(field), start=100.0)
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    send(session, surface_points(field, 50), start=1000.0)
    for _ in range(50):
        session.undo()
    assert not session.status().outdated and session.status().kept == 300
    session.undo()
    assert session.status().outdated and session.status().outdated
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    assert not session.status().outdated


def test_registration_names_a_stroke_of_interference(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field), start=100.0)
    session.collect(True)
    for i in range(24):         # touches a retractor
        session.add(sample(1000.0 + 0.2 * i, transform(T_TRACKER_BONE, [0.09, 0.005 * i, 0.0])))
    result = session.register(T_tracker_bone=T_TRACKER_BONE)
    words = 'stroke 301: 24 points, none on the bone: interference; the registration ignores it'
    assert result.success and result.message.endswith(f'; {words}')
    status = session.status()
    assert words in status.message and status.stroke_reports[-1].sentence == words
    assert all(each.rms_m < 1e-3 for each in status.stroke_reports[:-1])
    send(session, surface_points(field, 5), start=2000.0)      # not registered: no report
    assert len(session.status().stroke_reports) == 301
    for _ in range(6):
        session.undo()
    assert len(session.status().stroke_reports) == 300
    assert 'interference' not in session.register(T_tracker_bone=T_TRACKER_BONE).message


def test_a_notice_is_shown_until_the_session_continues(field: Field) -> None:
    session = Session(CONFIG, field)
    for end in (session.clear, session.register):
        session.set_notice('resumed from a journal')
        assert session.status().message.endswith('; resumed from a journal')
        end()
        assert 'journal' not in session.status().message
    session.set_notice('resumed from a journal')
    send(session, surface_points(field, 299))
    assert session.status().notice
    send(session, surface_points(field, 1), start=1000.0)
    assert not session.status().notice      # the session has continued


def test_another_model_drops_registration_and_landmarks(field: Field) -> None:
    session = with_landmarks(None)
    assert session.status().landmarks == 3
    assert not session.set_model(field)     # landmarks of the first model stay
    send(session, surface_points(field), start=100.0)
    assert session.register().success
    assert not session.set_model(field)
    assert session.status().pose_result is not None and session.landmarks() is not None
    assert session.set_model(bone(width=0.035))
    status = session.status()
    assert status.pose_result is None and status.landmarks == 0 and status.kept == 300


def test_settings_apply_to_a_session_with_points(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field, 50))
    session.configure(CONFIG.replaced({'gate.quality': 0.0, 'collect.max_points': 100}))
    assert send(session, surface_points(field, 60), start=100.0, quality=1.0)[-1] is Rejection.FULL
    with pytest.raises(InputError, match='clear before'):
        session.configure(CONFIG.replaced({'probe.frame_id': 'array'}))
    session.clear()
    session.configure(CONFIG.replaced({'probe.frame_id': 'array'}))
    assert session.add(sample(0.0, (0.0, 0.0, 0.0))) is Rejection.WRONG_FRAME


def test_status_says_why_points_are_rejected(field: Field) -> None:
    session = Session(Config.from_flat({'probe.frame_id': 'array'}), field)
    send(session, surface_points(field, 100))
    assert session.status().rejected['wrong_frame'] == 100
    assert 'not in "array": is probe.frame_id right' in session.status().message
    no_frame = Session(CONFIG, field)
    no_frame.add(sample(0.0, (0.0, 0.0, 0.0), ''))
    assert 'header.frame_id' in no_frame.status().message
    assert set(session.status().rejected) == {str(cause) for cause in Rejection}


def test_restart_clears_and_reports_why(field: Field) -> None:
    session, reported = registered(field), []
    session.listen(lambda event, value: reported.append((event, value)))
    session.restart('the clock went back by 3.0 s')
    status = session.status()
    assert (status.kept, status.landmarks, status.pose_result) == (0, 0, None)
    assert status.withdrawn.reason is Withdrawal.CLOCK_JUMPED and status.warning
    assert status.withdrawn.message.startswith('the clock went back by 3.0 s: ')
    assert status.notice == 'a new session was started: the clock went back by 3.0 s'
    assert ('clear', 'the clock went back by 3.0 s') in reported


def test_every_listener_receives_the_changes_until_it_stops(field: Field) -> None:
    session, first, second = Session(CONFIG, field), [], []
    on_first = lambda event, value: first.append(event)     # noqa: E731
    session.listen(on_first)
    send(session, surface_points(field, 1))
    session.listen(lambda event, value: second.append(event), from_start=True)
    assert second == ['session']
    session.stop_listening(on_first)
    session.collect(False)
    assert first == ['model', 'collecting', 'source', 'frame', 'point']
    assert second == ['session', 'collecting']
