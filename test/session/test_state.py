# SPDX-License-Identifier: Apache-2.0
"""The session state: which registration is the last one, what a clear keeps, what is reported."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from session_fixtures import CONFIG, T_TRACKER_BONE, bone, sample

from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.samples import Rejection
from gsdf_registration.field import Field
from gsdf_registration.session.accepted_registration import AcceptedRegistration
from gsdf_registration.session.record import SessionRecord
from gsdf_registration.session.state import SessionState

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


def test_clear_keeps_the_accepted_registration_but_no_last_result(state: SessionState) -> None:
    accept(state)
    state.refuse(REFUSAL)
    revision = state.revision
    state.clear()
    assert state.result is None and state.accepted is not None and state.outdated
    assert len(state.collection) == 0 and state.revision > revision


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
    assert other.record().to_dict(CONFIG) == saved
    assert other.succeeded == (last == 'accepted')


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
