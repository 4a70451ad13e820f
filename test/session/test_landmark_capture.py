# SPDX-License-Identifier: Apache-2.0
"""Landmarks and verification points of a session, captured from a stationary tip."""

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
    hold_noisy,
    registered,
    sample,
    send,
    surface_point,
    surface_points,
    with_landmarks,
)

from gsdf_registration.common.config import Config, LandmarksConfig
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.samples import Rejection
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.session import Session
from gsdf_registration.session import session as session_module
from gsdf_registration.session.landmark_capture import CapturedLandmark, LandmarkCapture


def test_captures_landmarks_in_order_with_their_spread(field: Field) -> None:
    session = Session(CONFIG.replaced({'collect.automatic': False}), field)    # no stroke is needed
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
    assert session.capture_landmark().message.endswith('this was the last one')
    assert 'all landmarks are captured' in session.capture_landmark().message
    taken = session.landmarks()
    assert np.array_equal(taken.model, LANDMARKS) and np.abs(taken.touched - tip).max() < 2e-4


def test_landmarks_are_in_the_order_of_their_names_whenever_they_were_captured() -> None:
    config = LandmarksConfig(names=['a', 'hip', 'b'], positions=[0.0] * 9)
    capture = LandmarkCapture()
    for name, place in (('b', 1.0), ('other', 2.0), ('hip', 3.0), ('a', 4.0), ('hip', 5.0)):
        capture.add(CapturedLandmark(name, np.zeros(3), np.full(3, place), 0.0, 0.0), config)
    assert capture.landmarks.names == ('a', 'hip', 'b', 'other')
    assert capture.landmarks.touched[:, 0].tolist() == [4.0, 5.0, 1.0, 2.0]


def test_says_why_a_landmark_is_not_captured(field: Field) -> None:
    assert 'set landmarks.names' in Session(Config(), field).capture_landmark().message
    session = Session(CONFIG, field)
    assert 'no probe tip is seen' in session.capture_landmark().message
    for i in range(200):
        session.add(sample(i / RATE, (0.001 * i, 0.0, 0.0), 'cam', arrival=i / RATE))
    assert 'the tip moves' in session.capture_landmark(now=2.5).message
    hold(session, np.zeros(3), 10.0, arrival=10.0)
    assert 'no probe tip is seen' in session.capture_landmark(now=60.0).message
    assert session.status().landmarks == 0


def test_invalid_samples_are_not_used_for_landmarks(field: Field) -> None:
    session = Session(CONFIG, field)
    session.add(sample(0.0, (0.0, 0.0, 0.0), 'cam'))
    for i in range(100):
        other = sample(1.0 + i / RATE, (0.1, 0.0, 0.0), 'other')
        assert session.add(other) is Rejection.WRONG_FRAME
        missing = sample(1.0 + i / RATE, (np.nan, 0.0, 0.0))
        assert session.add(missing) is Rejection.NOT_FINITE
    assert not session.capture_landmark().success


def test_fewer_than_three_landmarks_give_no_start_pose(field: Field,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(session_module, 'register', lambda points, field, config, **given: (
        seen.append(given['landmarks']), RegistrationResult.refused(Reason.NOT_CONVERGED, 'no'))[1])
    session = Session(CONFIG, field)
    hold(session, np.zeros(3), 0.0)
    session.capture_landmark()
    session.register()
    assert [len(landmarks) for landmarks in seen] == [0]


def test_reports_landmarks_touched_in_another_order(field: Field) -> None:
    session = Session(CONFIG, field)
    tip = transform(T_TRACKER_BONE, LANDMARKS)
    answers = []
    for count, place in enumerate((0, 2, 1)):
        hold(session, tip[place], 10.0 * count)
        answers.append(session.capture_landmark().message)
    assert 'but' not in answers[0]
    assert '"x" and "y" are 76 mm apart, but 54 mm on the model; check that' in answers[1]
    assert 'touched in this order: "x", "z", "y"' in answers[2]


def test_registration_names_a_misplaced_landmark(field: Field) -> None:
    session = Session(CONFIG, field)
    tip = transform(T_TRACKER_BONE, LANDMARKS + [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0] * 3])
    for count, place in enumerate(tip):
        hold(session, place, 10.0 * count)
        session.capture_landmark()
    send(session, surface_points(field), start=100.0)
    result = session.register()
    assert result.success
    assert ('landmark "y" was touched 20 mm from its place: was another one touched?'
            in result.message)
    assert session.status().landmark_errors == pytest.approx({'x': 0.0, 'y': 0.02, 'z': 0.0},
                                                             abs=1e-3)


def test_verification_measures_the_distance_to_the_surface(field: Field) -> None:
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
    """Return the number of points near a place."""
    return int((np.linalg.norm(session.points().positions - place, axis=1) < radius).sum())


@pytest.mark.parametrize('touch', ['verify', 'capture_landmark'])
def test_points_of_a_stationary_tip_are_not_used_in_the_fit(field: Field, touch: str) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field), start=100.0)
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    place = surface_point(field, 501)
    kept, around, revision = session.status().kept, near(session, place), session._state.revision
    end = hold_noisy(session, place, 1000.0)
    assert session.status().kept == kept + 80
    assert getattr(session, touch)().success
    assert session.status().kept == kept and near(session, place) == around
    assert session._state.revision > revision      # followers of the collection start again
    hold_noisy(session, place, end)       # it is still there, and its points are still not used
    status = session.status()
    assert (status.kept, status.rejected['touched']) == (kept, 160)
    assert not status.outdated
    send(session, [place + [0.0, 0.0, 0.01]], start=2000.0)     # it moves on
    assert session.status().kept == kept + 1
    assert status.received == status.kept + sum(status.rejected.values())


def test_refuses_to_verify_with_points_of_the_registration(field: Field) -> None:
    session = with_landmarks(field)
    send(session, surface_points(field), start=100.0)
    end = hold_noisy(session, surface_point(field, 501), 1000.0)
    assert session.register().success
    hold_noisy(session, surface_point(field, 501), end)
    answer = session.verify()
    assert not answer.success and 'has not moved since before the registration' in answer.message
    assert session.status().verification is None
    hold_noisy(session, surface_point(field, 2501), 1100.0)
    assert session.verify().success


def test_a_checkpoint_detects_a_displaced_array(field: Field) -> None:
    session = registered(field)
    surface = field.surface_points[500].astype(np.float64)
    along = np.cross(field.surface_normals[500].astype(np.float64), [0.3, 0.5, 0.8])
    along *= 0.0034 / np.linalg.norm(along)     # hardly changes the distance to the surface
    for count, (shift, good) in enumerate(((0.0, True), (0.1, True), (1.0, False))):
        hold(session, transform(T_TRACKER_BONE, surface + shift * along), 1000.0 + 300.0 * count)
        answer = session.verify()
        assert answer.success is good, answer.message
    assert answer.message.endswith(
        'checkpoint 1 moved 3.4 mm since it was first touched 10 min ago: was the array displaced? '
        'The pose is withdrawn')
    total = session.status().verification
    assert total is not None and not total.good
    assert total.points == 1 and total.moved_m == pytest.approx(0.0034)
    status = session.status()
    assert status.pose_result is None and status.kept == 300 and status.warning
    assert status.withdrawn is not None
    assert status.withdrawn.reason is Withdrawal.ARRAY_DISPLACED
    assert status.message.endswith(status.withdrawn.message)
    assert 'there is no registration' in session.verify().message


def test_a_new_registration_measures_the_verification_points_again(
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
    total = session.status().verification
    assert total is not None and total.worst_m == pytest.approx(0.003, abs=2e-4)
    assert not total.good


def test_a_landmark_is_a_measurement_only_with_a_standard_deviation(field: Field) -> None:
    config = CONFIG.replaced({'landmarks.sigmas': [0.0, 0.003, 0.0]})
    session = Session(config, field)
    for number in range(2):
        hold(session, np.array([0.1 * number, 0.0, 0.0]), 10.0 * number)
        assert session.capture_landmark().success
    usable = session.landmarks()
    assert usable.names == ('y',) and usable.sigmas.tolist() == [0.003]
    session.configure(config.replaced({'landmarks.sigmas': [0.001, 0.002, 0.0]}))
    assert session.landmarks().sigmas.tolist() == [0.001, 0.002]
    other = Session(CONFIG, field)
    other.restore(session.to_dict())
    assert other.landmarks().sigmas.tolist() == [0.001, 0.002]
