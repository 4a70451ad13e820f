# SPDX-License-Identifier: Apache-2.0
"""What is touched on purpose, the tip at rest: landmarks and verification points."""

from __future__ import annotations

import re

import numpy as np
import pytest
from session_fixtures import (
    CONFIG,
    LANDMARKS,
    RATE,
    T_TRACKER_BONE,
    hold,
    with_landmarks,
    surface_point,
    registered,
    rest,
    send,
    surface_points,
)

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.samples import Rejection
from gsdf_registration.field import Field
from gsdf_registration.session import Session
from gsdf_registration.session import session as session_module


def test_landmarks_are_taken_one_after_another_with_their_spread(field: Field) -> None:
    session = Session(CONFIG.replaced({'collect.automatic': False}), field)    # it needs no stroke
    noise = np.random.default_rng(0).normal(0.0, 0.0003, (50, 3))
    tip = transform(T_TRACKER_BONE, LANDMARKS)
    for i, offset in enumerate(noise):
        session.add(sample(i / RATE, tip[0] + offset, 'cam'))
    answer = session.capture_landmark()
    assert answer.success
    assert re.fullmatch(
        r'landmark "x" captured from 4[01] samples, spread 0\.(4|5)\d mm RMS; next is "y"',
        answer.message)
    again = session.capture_landmark()
    assert not again.success and again.message == 'the tip is still at landmark "x"; touch "y"'
    hold(session, tip[1], 10.0)
    assert session.capture_landmark().success
    hold(session, tip[2], 20.0)
    assert session.capture_landmark().message.endswith('that was the last one')
    assert 'all landmarks are captured' in session.capture_landmark().message
    taken = session.landmarks()
    assert taken is not None
    model, tracker = taken
    assert np.array_equal(model, LANDMARKS) and np.abs(tracker - tip).max() < 2e-4


def test_landmarks_are_refused_with_a_reason(field: Field) -> None:
    assert 'set landmarks.names' in Session(Config(), field).capture_landmark().message
    session = Session(CONFIG, field)
    assert 'no probe tip is seen' in session.capture_landmark().message
    for i in range(200):
        session.add(sample(i / RATE, (0.001 * i, 0.0, 0.0), 'cam', arrival=i / RATE))
    assert 'the tip moves' in session.capture_landmark(now=2.5).message
    hold(session, np.zeros(3), 10.0, arrival=10.0)
    assert 'no probe tip is seen' in session.capture_landmark(now=60.0).message
    assert session.status().landmarks == 0


def test_unsound_samples_never_become_a_landmark(field: Field) -> None:
    session = Session(CONFIG, field)
    session.add(sample(0.0, (0.0, 0.0, 0.0), 'cam'))
    for i in range(100):
        assert session.add(sample(1.0 + i / RATE, (0.1, 0.0, 0.0), 'other')) is Rejection.WRONG_FRAME
        assert session.add(sample(1.0 + i / RATE, (np.nan, 0.0, 0.0), 'cam')) is Rejection.NOT_FINITE
    assert not session.capture_landmark().success


def test_fewer_than_three_landmarks_are_no_guess(field: Field,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(session_module, 'register', lambda points, field, config, **given: (
        seen.append(given['landmarks']), RegistrationResult.refused(Reason.NOT_CONVERGED, 'no'))[1])
    session = Session(CONFIG, field)
    hold(session, np.zeros(3), 0.0)
    session.capture_landmark()
    session.register()
    assert seen == [None]


def test_landmarks_touched_in_another_order_are_told_at_once(field: Field) -> None:
    session = Session(CONFIG, field)
    tip = transform(T_TRACKER_BONE, LANDMARKS)
    answers = []
    for count, place in enumerate((0, 2, 1)):
        hold(session, tip[place], 10.0 * count)
        answers.append(session.capture_landmark().message)
    assert 'but' not in answers[0]
    assert '"x" and "y" are 76 mm apart, but 54 mm on the model; check that' in answers[1]
    assert 'touched in this order: "x", "z", "y"' in answers[2]


def test_a_landmark_touched_elsewhere_is_named_after_registration(field: Field) -> None:
    session = Session(CONFIG, field)
    tip = transform(T_TRACKER_BONE, LANDMARKS + [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0] * 3])
    for count, place in enumerate(tip):
        hold(session, place, 10.0 * count)
        session.capture_landmark()
    send(session, surface_points(field), start=100.0)
    result = session.register()
    assert result.success
    assert 'landmark "y" was touched 20 mm from its place: was it another one?' in result.message
    assert session.status().landmark_misses == pytest.approx({'x': 0.0, 'y': 0.02, 'z': 0.0},
                                                             abs=1e-3)


def test_verification_measures_and_judges(field: Field) -> None:
    session = registered(field)
    assert not Session(CONFIG, field).verify().success
    surface, normal = field.surface_points[500].astype(float), field.surface_normals[500].astype(
        float)
    for start, off, good, words in (
            (1000.0, 0.0005, True, '0.5 mm outside'), (1010.0, -0.001, True, '1.0 mm inside'),
            (1020.0, 0.005, False, '5.0 mm outside')):
        hold(session, transform(T_TRACKER_BONE, surface + off * normal), start)
        answer = session.verify()
        assert answer.success is good and words in answer.message
    before = session.status().pose_result
    assert session.status().pose_result is before


def near(session: Session, place: Array, radius: float = 0.004) -> int:
    """Return how many points of the collection lie there."""
    return int((np.linalg.norm(session.points().positions - place, axis=1) < radius).sum())


@pytest.mark.parametrize('touch', ['verify', 'capture_landmark'])
def test_what_is_touched_on_purpose_is_kept_out_of_the_fit(field: Field, touch: str) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field), start=100.0)
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    place = surface_point(field, 501)
    kept, around, revision = session.status().kept, near(session, place), session._state.revision
    end = hold_noisy(session, place, 1000.0)
    assert session.status().kept == kept + 80
    assert getattr(session, touch)().success
    assert session.status().kept == kept and near(session, place) == around
    assert session._state.revision > revision      # who follows the collection hears of it
    hold_noisy(session, place, end)       # it still rests there, and is still not for the fit
    status = session.status()
    assert (status.kept, status.rejected['touched']) == (kept, 160)
    assert not status.outdated
    send(session, [place + [0.0, 0.0, 0.01]], start=2000.0)     # it goes on
    assert session.status().kept == kept + 1
    assert status.received == status.kept + sum(status.rejected.values())


def test_a_place_that_the_registration_was_found_with_is_no_verification(field: Field) -> None:
    session = with_landmarks(field)
    send(session, surface_points(field), start=100.0)
    end = hold_noisy(session, surface_point(field, 501), 1000.0)
    assert session.register().success
    hold_noisy(session, surface_point(field, 501), end)
    answer = session.verify()
    assert not answer.success and 'rested here since before the registration' in answer.message
    assert session.status().verification is None
    hold_noisy(session, surface_point(field, 2501), 1100.0)
    assert session.verify().success


def test_a_checkpoint_touched_again_tells_that_the_array_was_bumped(field: Field) -> None:
    session = registered(field)
    surface = field.surface_points[500].astype(np.float64)
    along = np.cross(field.surface_normals[500].astype(np.float64), [0.3, 0.5, 0.8])
    along *= 0.0034 / np.linalg.norm(along)     # which the distance to the surface hardly shows
    for count, (shift, good) in enumerate(((0.0, True), (0.1, True), (1.0, False))):
        hold(session, transform(T_TRACKER_BONE, surface + shift * along), 1000.0 + 300.0 * count)
        answer = session.verify()
        assert answer.success is good, answer.message
    assert answer.message.endswith(
        'checkpoint 1 moved 3.4 mm since it was first touched 10 min ago: was the array bumped?')
    glance = session.status().verification
    assert glance is not None and not glance.good
    assert glance.points == 1 and glance.moved_m == pytest.approx(0.0034)


def test_verification_points_are_measured_anew_when_the_bone_is_registered_anew(
        field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    session = registered(field)
    normal = T_TRACKER_BONE[:3, :3] @ field.surface_normals[500]
    hold(session, surface_point(field, 500), 1000.0)
    assert session.verify().success
    shifted = T_TRACKER_BONE.copy()
    shifted[:3, 3] += 0.003 * normal
    monkeypatch.setattr(session_module, 'register', lambda *_, **__: RegistrationResult(
        Reason.CONVERGED, 'found', T_tracker_bone=shifted))
    session.register()
    glance = session.status().verification
    assert glance is not None and glance.worst_m == pytest.approx(0.003, abs=2e-4)
    assert not glance.good
