# SPDX-License-Identifier: Apache-2.0
"""A session with many points answers at once, and says when it stores no more."""

from __future__ import annotations

import time

import numpy as np
import pytest
from session_fixtures import CONFIG, T_TRACKER_BONE, sample

from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.samples import Rejection, without_tools
from gsdf_registration.field import Field
from gsdf_registration.session import Session
from gsdf_registration.session.accepted_registration import AcceptedRegistration

COUNT = 200_000


def fill(session: Session, count: int) -> None:
    """Add points of slow strokes, 2 mm apart."""
    for i in range(count):
        session.add(sample(0.02 * i, (1e-3 * (i % 50), 1e-3 * (i // 50 % 50), 0.0)))


def test_says_that_collecting_has_stopped_when_no_more_points_fit(field: Field) -> None:
    session = Session(CONFIG.replaced({'collect.max_points': 100}), field)
    session.collect(True)
    fill(session, 99)
    assert not session.status().full and session.status().message.startswith('collecting; ')
    fill(session, 130)
    status = session.status()
    assert status.full and status.kept == 100 and status.state == 'collecting'
    assert status.message.startswith(
        'collecting has stopped: no more points can be stored (collect.max_points); register')
    assert status.received == status.kept + sum(status.rejected.values())
    session.register()      # refused: the points are flat
    assert 'collecting has stopped' in session.status().message
    session.clear()
    assert not session.status().full


def test_rejects_points_for_which_there_is_no_room(field: Field) -> None:
    session = Session(CONFIG.replaced({'collect.max_points': 100}), field)
    session.collect(True)
    fill(session, 130)
    assert session.add(sample(100.0, (0.0, 0.0, 0.0))) is Rejection.FULL


@pytest.fixture(scope='module')
def large(field: Field) -> Session:
    """Return a session with many points, all of them registered."""
    session = Session(CONFIG, field)
    collection = session._state.collection
    rng = np.random.default_rng(0)
    strokes = np.repeat(np.arange(1, 101), COUNT // 100)
    collection.restore(
        without_tools(rng.uniform(size=(COUNT, 3)), np.arange(COUNT) / 4000.0,
                      strokes.astype(np.int32), np.zeros(COUNT, np.int32)), 'tracker', {}, CONFIG)
    result = RegistrationResult(
        Reason.CONVERGED, 'registered', T_TRACKER_BONE, np.eye(6), COUNT, 10_000, 10_000,
        residuals_m=np.zeros(COUNT), weights=np.ones(COUNT))
    session._state.accept(AcceptedRegistration(
        result, collection.points(), collection.serials(), 'tracker'))
    return session


def test_status_of_many_points_takes_no_time(large: Session) -> None:
    assert len(large.status().stroke_reports) == 100
    durations = []
    for _ in range(20):
        started = time.perf_counter()
        status = large.status()
        durations.append(time.perf_counter() - started)
    assert not status.outdated and min(durations) < 0.002


def test_a_registration_is_outdated_once_a_point_is_dropped(large: Session) -> None:
    assert not large.status().outdated
    large.undo()
    assert large.status().outdated and len(large.status().stroke_reports) == 99
