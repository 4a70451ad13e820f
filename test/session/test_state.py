# SPDX-License-Identifier: Apache-2.0
"""The session state: which registration is the last one, what a clear keeps, what is reported."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from session_fixtures import CONFIG, T_TRACKER_BONE, bone, sample

from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.samples import Rejection
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.session.accepted_registration import AcceptedRegistration
from gsdf_registration.session.record import SessionRecord
from gsdf_registration.session.state import SessionState
from msg_adapters.packed_rows import packed

REFUSAL = RegistrationResult.refused(Reason.AMBIGUOUS, 'no')


@pytest.fixture
def state(field: Field) -> SessionState:
    made = SessionState(CONFIG, field)
    for i in range(20):
        assert made.add(sample(float(i), (0.001 * i, 0.0, -1.0))) is None
    return made


def accept(state: SessionState) -> RegistrationResult:
    points = state.collection.points()
    count = len(points.stamps)
    result = RegistrationResult(Reason.CONVERGED, 'found', T_TRACKER_BONE,
                                residuals_m=np.full(count, 1e-4), weights=np.ones(count))
    return state.accept(AcceptedRegistration(result, points, state.collection.serials(), 'cam'))


def test_the_last_result_is_the_accepted_one_or_the_refusal(state: SessionState) -> None:
    assert state.result is None and not state.succeeded
    accepted = accept(state)
    assert state.accepted is not None and state.accepted.result is accepted is state.result
    state.refuse(REFUSAL)
    assert state.result is REFUSAL and not state.succeeded
    assert state.accepted.result is accepted
    accept(state)
    assert state.succeeded and state.refusal is None


def test_clear_withdraws_the_pose_and_begins_another_session(state: SessionState) -> None:
    accept(state)
    state.refuse(REFUSAL)
    state.set_initial_pose(T_TRACKER_BONE, 'cam')
    revision, session_id = state.revision, state.session_id
    state.clear()
    assert state.result is state.accepted is state.initial_pose is None
    assert len(state.collection) == 0 and state.revision > revision
    assert state.session_id != session_id and state.registration_id == 0
    assert state.withdrawn is not None
    assert state.withdrawn[0] is Withdrawal.CLEARED
    assert state.withdrawn[2:] == (session_id, 1, 'cam')
    before = state.withdrawn
    state.clear()       # there is no pose to withdraw
    assert state.withdrawn is before


def test_registrations_are_numbered(state: SessionState) -> None:
    assert state.registration_id == 0
    for number in (1, 2):
        accept(state)
        state.refuse(REFUSAL)
        assert state.registration_id == number


def test_a_withdrawn_pose_leaves_the_points(state: SessionState) -> None:
    events: list[str] = []
    state.listen(lambda event, value: events.append(event))
    state.withdraw_pose(Withdrawal.POINTS_DROPPED, 'no')
    assert state.withdrawn is None and 'no_pose' not in events
    accept(state)
    state.withdraw_pose(Withdrawal.POINTS_DROPPED, 'no')
    assert state.accepted is state.result is None and len(state.collection) == 20
    assert state.withdrawn is not None and state.withdrawn.reason is Withdrawal.POINTS_DROPPED
    assert events[-1] == 'no_pose'
    accept(state)
    assert state.withdrawn is None and state.registration_id == 2


def test_an_initial_pose_applies_until_a_registration_is_accepted(state: SessionState) -> None:
    answer = state.set_initial_pose(T_TRACKER_BONE, 'map')
    assert not answer.success and 'is in frame "map", but the points are in "cam"' in answer.message
    assert state.guess is None
    assert state.set_initial_pose(T_TRACKER_BONE, 'cam').success
    state.refuse(REFUSAL)
    assert state.guess is T_TRACKER_BONE
    accept(state)
    assert state.guess is None


def test_an_initial_pose_before_the_first_point_applies_in_its_frame(field: Field) -> None:
    state = SessionState(CONFIG, field)
    assert state.set_initial_pose(T_TRACKER_BONE, 'map').success
    assert state.guess is None
    state.add(sample(0.0, (0.0, 0.0, 0.0), 'map'))
    assert state.guess is T_TRACKER_BONE


def test_the_points_of_a_registration_are_views_of_the_collection(state: SessionState) -> None:
    accept(state)
    assert state.accepted is not None
    assert np.shares_memory(state.accepted.points.positions, state.collection.points().positions)
    assert not state.outdated
    state.undo()
    assert state.outdated and len(state.accepted.points.stamps) == 20


def test_another_bone_has_no_registration(state: SessionState) -> None:
    accept(state)
    assert not state.set_model(bone()) and state.accepted is not None     # the same bone again
    assert state.set_model(bone(width=0.035))
    assert state.accepted is None and state.result is None and len(state.collection) == 20
    assert state.withdrawn is not None and state.withdrawn.reason is Withdrawal.MODEL_CHANGED


def test_settings_that_change_the_frame_need_an_empty_session(state: SessionState) -> None:
    other = CONFIG.replaced({'probe.frame_id': 'array'})
    with pytest.raises(InputError, match='clear before'):
        state.configure(other)
    assert state.config is CONFIG
    state.clear()
    state.configure(other)
    assert state.config is other
    assert state.add(sample(100.0, (0.0, 0.0, 0.0))) is Rejection.WRONG_FRAME


@pytest.mark.parametrize('last', ['accepted', 'refused', 'none'])
def test_a_record_restores_the_state(state: SessionState, field: Field, last: str) -> None:
    accept(state)
    if last == 'refused':
        state.refuse(REFUSAL)
    elif last == 'none':
        state.clear()
    saved = state.record().to_dict(CONFIG)
    other = SessionState(CONFIG, field)
    other.restore(SessionRecord.from_dict(saved, field.bone_sha256))
    assert json.dumps(other.record().to_dict(CONFIG), default=packed) == json.dumps(
        saved, default=packed)
    assert other.succeeded == (last == 'accepted')
    assert other.registration_id == (0 if last == 'none' else 1)
    accept(state)
    state.restore(SessionRecord.from_dict(saved, field.bone_sha256))
    reason = None if state.withdrawn is None else state.withdrawn.reason
    assert reason is (Withdrawal.SESSION_LOADED if last == 'none' else None)


def test_reports_each_change_to_every_listener(state: SessionState) -> None:
    reported: list[list[tuple[str, Any]]] = [[], []]
    for events in reported:
        state.listen(lambda event, value, events=events: events.append((event, value)))
    state.add(sample(20.0, (0.02, 0.0, -1.0)))
    state.add(sample(20.0, (0.02, 0.0, -1.0)))
    state.clear('the clock went back by 2.0 s')
    assert [event for event, _ in reported[0][:3]] == ['model', 'collecting', 'source']
    assert reported[0][3:] == reported[1][3:] == [
        ('frame', 'cam'), ('point', [21, 0, 20.0, 0.02, 0.0, -1.0]),
        ('rejected', {'not_monotonic': 1}), ('clear', 'the clock went back by 2.0 s'),
        ('source', '/probe/tip')]
