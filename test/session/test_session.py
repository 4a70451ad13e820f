# SPDX-License-Identifier: Apache-2.0
"""What an operator does with strokes and settings, in order and out of order."""

from __future__ import annotations

import numpy as np
import pytest
from session_fixtures import (
    CONFIG,
    LANDMARKS,
    RATE,
    T_TRACKER_BONE,
    bone,
    with_landmarks,
    registered,
    send,
    surface_points,
)

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.rigid import transform
from gsdf_registration.common.samples import Rejection
from gsdf_registration.field import Field
from gsdf_registration.session import Session


def test_the_whole_job(field: Field) -> None:
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


def test_each_state_and_its_sentence(field: Field) -> None:
    session = Session(CONFIG)
    assert session.status().state == 'no_model' and 'model.path' in session.status().message
    session.set_model(field)
    assert session.status().state == 'collecting'
    assert session.status(
    ).message == 'collecting; 0 points in 0 strokes held; next landmark is "x"'
    session.collect(False)
    assert session.status().state == 'idle'
    session.register()
    assert session.status().state == 'refused' and session.status().message.startswith(
        'too few points: 0')
    session.collect(True)
    assert session.status().state == 'collecting'


def test_what_was_refused_is_no_news_once_more_is_collected(field: Field) -> None:
    session = Session(CONFIG, field)
    session.register()
    send(session, surface_points(field, 29))
    assert session.status().state == 'refused'
    send(session, surface_points(field, 1), start=100.0)
    assert session.status().message == (
        'collecting; 30 points in 30 strokes held; next landmark is "x"')


def test_a_pose_stays_the_news_while_only_what_came_later_is_undone(field: Field) -> None:
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
    assert session.add(sample(0.0, (0.0, 0.0, 0.0), 'cam')) is Rejection.NOT_COLLECTING
    assert session.collect(True).success
    assert session.add(sample(1.0, (0.0, 0.0, 0.0), 'cam')) is None


def test_without_a_model_there_is_no_registration() -> None:
    assert Session(CONFIG).register().reason is Reason.NO_MODEL


def test_a_first_guess_may_be_given(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field))
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    assert session.register(landmarks=(LANDMARKS, transform(T_TRACKER_BONE, LANDMARKS))).success


def test_a_refusal_leaves_the_last_good_pose(field: Field) -> None:
    session = registered(field)
    good = session.status().pose_result
    session.undo(), session.clear()
    assert session.register().reason is Reason.TOO_FEW_POINTS
    status = session.status()
    assert status.state == 'refused' and status.pose_result is good and status.result is not good


def test_strokes_and_undo(field: Field) -> None:
    session = Session(CONFIG, field)
    line = np.linspace([0.0, 0.0, 0.0], [0.1, 0.0, 0.0], 100)
    for stroke in range(3):
        assert session.collect(True).success
        for i, point in enumerate(line):
            session.add(sample(10.0 * stroke + i / RATE, point, 'cam'))
        session.collect(False)
    assert (session.status().kept, session.status().strokes) == (300, 3)
    answer = session.undo()
    assert answer.success
    assert answer.message == 'dropped the last stroke, 100 points; 200 points in 2 strokes held'
    session.undo(), session.undo()
    assert not session.undo().success
    assert session.status().kept == 0


def test_clear_drops_points_and_landmarks(field: Field) -> None:
    session = registered(field)
    assert 'last good pose stands' in session.clear().message
    status = session.status()
    assert (status.received, status.kept, status.landmarks, status.state) == (0, 0, 0, 'collecting')
    assert status.result is None and status.pose_result is not None


def test_undo_of_several_strokes_and_of_parts_of_one(field: Field) -> None:
    session = Session(CONFIG, field)
    line = np.linspace([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], 80)
    for stroke in range(2):
        session.collect(True)
        for i, point in enumerate(line):
            session.add(sample(100.0 * stroke + i / RATE, point, 'cam'))
    for i, point in enumerate(line):        # after a silence
        session.add(sample(150.0 + i / RATE, point, 'cam'))
    assert session.undo().message == (
        'dropped the last stroke, 80 points, which a silence had split off the one before: undo '
        'again to drop that too; 160 points in 2 strokes held')
    assert session.undo().message == (
        'dropped the last stroke, 80 points; 80 points in 1 stroke held')
    assert session.undo().success and not session.undo().success


def test_a_pose_is_outdated_when_points_it_was_found_with_were_dropped(field: Field) -> None:
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
    session.clear()
    assert session.status().outdated


def test_a_stroke_of_interference_is_named_and_gone_after_undo(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field), start=100.0)
    session.collect(True)
    for i in range(24):         # a retractor
        session.add(sample(1000.0 + 0.2 * i, transform(T_TRACKER_BONE, [0.09, 0.005 * i, 0.0]),
                          'cam'))
    result = session.register(T_tracker_bone=T_TRACKER_BONE)
    words = 'stroke 301: 24 points, none on the bone: interference; the registration ignores it'
    assert result.success and result.message.endswith(f'; {words}')
    status = session.status()
    assert words in status.message and status.stroke_reports[-1].sentence == words
    assert all(each.rms_m < 1e-3 for each in status.stroke_reports[:-1])
    send(session, surface_points(field, 5), start=2000.0)      # not in it: nothing is said of them
    assert len(session.status().stroke_reports) == 301
    for _ in range(6):
        session.undo()
    assert len(session.status().stroke_reports) == 300
    assert 'interference' not in session.register(T_tracker_bone=T_TRACKER_BONE).message


def test_a_remark_goes_with_the_status_until_there_is_news(field: Field) -> None:
    session = Session(CONFIG, field)
    for forget in (session.clear, session.register):
        session.remark('taken up from a journal')
        assert session.status().message.endswith('; taken up from a journal')
        forget()
        assert 'journal' not in session.status().message
    session.remark('taken up from a journal')
    send(session, surface_points(field, 299))
    assert session.status().remark
    send(session, surface_points(field, 1), start=1000.0)
    assert not session.status().remark      # the operator has gone on


def test_another_model_drops_what_is_true_of_one_bone_only(field: Field) -> None:
    session = with_landmarks(None)
    assert session.status().landmarks == 3
    assert not session.set_model(field)     # they were named for it
    send(session, surface_points(field), start=100.0)
    assert session.register().success
    assert not session.set_model(field)
    assert session.status().pose_result is not None and session.landmarks() is not None
    assert session.set_model(bone(width=0.035))
    status = session.status()
    assert status.pose_result is None and status.landmarks == 0 and status.kept == 300


def test_settings_change_while_points_are_held(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field, 50))
    session.configure(CONFIG.replaced({'gate.quality': 0.0, 'collect.max_points': 100}))
    assert send(session, surface_points(field, 60), start=100.0, quality=1.0)[-1] is Rejection.FULL
    with pytest.raises(InputError, match='clear before'):
        session.configure(CONFIG.replaced({'probe.frame_id': 'array'}))
    session.clear()
    session.configure(CONFIG.replaced({'probe.frame_id': 'array'}))
    assert session.add(sample(0.0, (0.0, 0.0, 0.0), 'cam')) is Rejection.WRONG_FRAME


def test_status_says_what_is_wrong_with_the_points(field: Field) -> None:
    session = Session(Config.from_flat({'probe.frame_id': 'array'}), field)
    send(session, surface_points(field, 100))
    assert session.status().rejected['wrong_frame'] == 100
    assert 'not in "array": is probe.frame_id right' in session.status().message
    nameless = Session(CONFIG, field)
    nameless.add(sample(0.0, (0.0, 0.0, 0.0), ''))
    assert 'header.frame_id' in nameless.status().message
    assert set(session.status().rejected) == {str(cause) for cause in Rejection}
