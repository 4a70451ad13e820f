# SPDX-License-Identifier: Apache-2.0
"""Test the radius of a ball tip that is set before, while and after points are collected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from session_fixtures import (
    CONFIG,
    T_TRACKER_BONE,
    bone,
    hold,
    registered,
    send,
    surface_points,
    with_landmarks,
)

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import transform
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.session import Session
from gsdf_registration.session.events import Replay
from gsdf_registration.session.state import SessionState

RADIUS = 0.0015
BALL = CONFIG.replaced({'probe.tip_radius': RADIUS})


@pytest.fixture(scope='module')
def field() -> Field:
    return bone()


def ball_centre(field: Field, row: int) -> np.ndarray:
    point = field.surface_points[row].astype(np.float64)
    return transform(T_TRACKER_BONE, point + RADIUS * field.surface_normals[row])


def registered_with_ball(field: Field, config: Config = BALL) -> Session:
    session = with_landmarks(field, config)
    rows = np.linspace(0, len(field.surface_points) - 1, 300).astype(int)
    send(session, np.array([ball_centre(field, row) for row in rows]), start=100.0)
    assert session.register().success
    return session


def test_verification_measures_from_the_surface_of_the_ball(field: Field) -> None:
    session = registered_with_ball(field)
    end = hold(session, ball_centre(field, 700), 1000.0)
    answer = session.verify(end)
    assert answer.success and abs(answer.detail.distance_m) < 3e-4, answer.message


def test_another_radius_withdraws_the_pose_with_a_reason_and_keeps_the_points(
        field: Field) -> None:
    session = registered(field)
    before, revision = session.points(), session.revision
    session.configure(BALL)
    status = session.status()
    assert status.pose_result is None and status.withdrawn is not None
    assert status.withdrawn.reason is Withdrawal.TIP_CHANGED
    assert 'probe.tip_radius was changed' in status.withdrawn.message
    np.testing.assert_array_equal(session.points().positions, before.positions)
    assert session.revision != revision     # whatever follows the points starts again
    session.configure(CONFIG)
    assert session.register().success


def test_the_same_radius_keeps_the_pose(field: Field) -> None:
    session = registered_with_ball(field)
    session.configure(BALL.replaced({'live.enabled': False}))
    assert session.status().pose_result is not None


def test_a_new_model_is_used_with_the_radius(field: Field) -> None:
    state = SessionState(BALL, None)
    state.set_model(field)
    assert state.field is not None and state.field.tip_radius == RADIUS
    state.configure(CONFIG)
    assert state.field.tip_radius == 0.0


def test_a_session_of_another_radius_is_restored_without_its_pose(field: Field) -> None:
    saved = registered(field).to_dict()
    same, other = Session(CONFIG, field), Session(BALL, field)
    same.restore(saved)
    other.restore(saved)
    assert same.status().pose_result is not None
    assert other.status().pose_result is None and len(other.points().positions) == 300
    withdrawn = other.status().withdrawn
    assert withdrawn is not None and 'probe.tip_radius 0 m, which is now 0.0015 m' in (
        withdrawn.message)


def test_the_events_tell_the_radius(field: Field) -> None:
    replay, session = Replay(), Session(CONFIG, field)

    def listen(event: str, value: Any) -> None:
        replay.apply(event, value)
    session.listen(listen)
    send(session, surface_points(field)[:20])
    session.configure(BALL)
    assert replay.session['parameters']['probe.tip_radius'] == RADIUS
