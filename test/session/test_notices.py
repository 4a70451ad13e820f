# SPDX-License-Identifier: Apache-2.0
"""How long the status shows a notice and the last registration."""

from __future__ import annotations

import pytest
from session_fixtures import CONFIG, sample

from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.session.notices import NOTICE_LIFETIME, Notices
from gsdf_registration.session.state import SessionState

MIN_POINTS = CONFIG.limits.min_points


@pytest.fixture
def state() -> SessionState:
    return SessionState(CONFIG, None)


def add_points(state: SessionState, count: int) -> None:
    first = len(state.collection)
    for i in range(first, first + count):
        assert state.add(sample(float(i), (0.001 * i, 0.0, 0.0))) is None


def test_a_notice_ends_after_many_points(state: SessionState) -> None:
    notices = Notices(state)
    notices.set('resumed')
    add_points(state, NOTICE_LIFETIME * MIN_POINTS - 1)
    assert notices.text == 'resumed'
    add_points(state, 1)
    assert notices.text == ''


def test_a_refusal_is_current_until_more_points_or_a_stroke(state: SessionState) -> None:
    notices = Notices(state)
    notices.on_registration()
    assert not notices.registration_is_current      # there is no result
    state.refuse(RegistrationResult.refused(Reason.AMBIGUOUS, 'no'))
    notices.on_registration()
    add_points(state, MIN_POINTS - 1)
    assert notices.registration_is_current
    add_points(state, 1)
    assert not notices.registration_is_current
    notices.on_registration()
    assert notices.registration_is_current
    notices.on_stroke()
    assert not notices.registration_is_current


def test_a_registration_ends_the_notice(state: SessionState) -> None:
    notices = Notices(state)
    notices.set('resumed')
    notices.on_registration()
    assert notices.text == ''
