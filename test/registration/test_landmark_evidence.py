# SPDX-License-Identifier: Apache-2.0
"""Landmarks with a standard deviation are measurements of the pose, and mistakes are left out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_bone import T_TRACKER_BONE, ball_mesh, bone_field, bone_mesh, field_of, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.formatting import format_length
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.landmark_evidence import for_tip, log_likelihood, plausible
from gsdf_registration.registration.pipeline import register

SIGMA = 0.003
NAMES = ('a', 'b', 'c', 'd')
# m, bone frame, outside the bone as a joint centre of the other end is
PLACES = np.array([[0.1, 0.12, 0.2], [-0.1, 0.1, 0.0], [0.05, -0.15, 0.1], [0.0, 0.1, -0.2]])
NEAR = T_TRACKER_BONE @ rigid.exp([0.03, -0.02, 0.04, 0.002, -0.001, 0.002])
FAST = Config.from_flat({'search.rotations': 20, 'search.places': 10, 'search.parts': 0})


def points(seed: int = 0, mesh: trimesh.Trimesh | None = None, radius: float = 0.045) -> Array:
    return rigid.transform(T_TRACKER_BONE, touched_points(400, seed, 3e-4, radius, mesh))


def touched(count: int, seed: int = 0, sigma: float = SIGMA, **off: tuple[float, ...]) -> Landmarks:
    """Return landmarks with noise; ``off`` moves some by name, m."""
    noise = sigma * np.random.default_rng(seed).normal(size=(count, 3))
    there = rigid.transform(T_TRACKER_BONE, PLACES[:count]) + noise
    for name, shift in off.items():
        there[NAMES.index(name)] += shift
    return Landmarks.of(PLACES[:count], there, np.full(count, sigma), NAMES[:count])


def near_truth(result: RegistrationResult, limit: float, field: Field) -> bool:
    assert result.T_tracker_bone is not None, result.message
    surface = field.surface_points.astype(np.float64)
    return rigid.rms_displacement(result.T_tracker_bone, T_TRACKER_BONE, surface) < limit


@cache
def ellipsoid() -> trimesh.Trimesh:
    """Return a body that four poses map onto itself."""
    return ball_mesh(np.array([0.03, 0.04, 0.055]))


def test_a_far_landmark_makes_the_pose_more_accurate_and_the_prediction_says_so() -> None:
    here = PLACES[:1]
    before, after, errors = [], [], []
    for seed in range(10):
        alone, fused = (register(points(seed), bone_field(), FAST, landmarks=landmarks,
                                 T_tracker_bone=NEAR)
                        for landmarks in (None, touched(1, seed, 2e-4)))
        for found, off in ((alone, before), (fused, after)):
            assert found.T_tracker_bone is not None, found.message
            off.append(rigid.rms_displacement(found.T_tracker_bone, T_TRACKER_BONE, here))
        assert fused.predicted_tre_m['rms'] < alone.predicted_tre_m['rms']
        twist = np.concatenate([
            fused.T_tracker_bone[:3, 3] - T_TRACKER_BONE[:3, 3],
            rigid.rotation_log(fused.T_tracker_bone[:3, :3] @ T_TRACKER_BONE[:3, :3].T)])
        errors.append(twist @ np.linalg.solve(fused.covariance, twist))
    assert rigid.rms(np.array(after)) < 0.5 * rigid.rms(np.array(before))
    assert 2.0 < np.mean(errors) < 12.0     # its expectation is 6


@pytest.mark.parametrize(('count', 'wrong'), [(1, 'a'), (3, 'b'), (4, 'c')])
def test_one_wrong_landmark_is_named_and_changes_nothing(count: int, wrong: str) -> None:
    field = bone_field()
    mistaken = touched(count, **{wrong: (0.0, 0.025, 0.0)})
    found = register(points(), field, FAST, landmarks=mistaken, T_tracker_bone=NEAR)
    without = mistaken.rows([k for k, name in enumerate(mistaken.names) if name != wrong])
    expected = register(points(), field, FAST, landmarks=without, T_tracker_bone=NEAR)
    assert found.success and expected.success
    np.testing.assert_allclose(found.T_tracker_bone, expected.T_tracker_bone, atol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6)
    assert {fit.name for fit in found.landmarks if not fit.used} == {wrong}
    fit = next(fit for fit in found.landmarks if not fit.used)
    assert fit.residual_m == pytest.approx(0.025, abs=0.01) and fit.deviations > 4.0
    assert f'"{wrong}" is {format_length(fit.residual_m)} from its place' in found.message
    assert 'a landmark is left out as a mistake' in found.message


def test_a_landmark_that_fits_is_reported_against_its_standard_deviation() -> None:
    found = register(points(), bone_field(), FAST, landmarks=touched(2), T_tracker_bone=NEAR)
    assert [(fit.name, fit.used, fit.sigma_m) for fit in found.landmarks] == [
        ('a', True, SIGMA), ('b', True, SIGMA)]
    assert all(0.0 < fit.residual_m < 3.0 * SIGMA and fit.deviations < 4.0
               for fit in found.landmarks)
    assert 'mistake' not in found.message


def test_landmarks_without_a_standard_deviation_only_give_a_guess() -> None:
    guess = touched(3)
    guess = Landmarks.of(guess.model, guess.touched)
    found = register(points(), bone_field(), FAST, landmarks=guess)
    assert found.landmarks == ()
    start = rigid.fit_points(guess.touched, guess.model)
    np.testing.assert_array_equal(
        found.T_tracker_bone,
        register(points(), bone_field(), FAST, T_tracker_bone=start).T_tracker_bone)


def test_a_registration_that_most_landmarks_contradict_is_refused() -> None:
    wrong = touched(3, a=(0.0, 0.025, 0.03), b=(0.0, 0.025, 0.0))
    found = register(points(), bone_field(), landmarks=wrong)
    assert found.reason is Reason.MODEL_MISMATCH
    assert found.message.startswith('2 of 3 landmarks contradict the points')


def test_of_two_landmarks_that_contradict_only_each_other_neither_is_used() -> None:
    # nothing is known from the points
    marks = touched(2, b=(0.0, 0.03, 0.0))
    start = rigid.inverse(T_TRACKER_BONE)
    tiny = np.diag([1.0, 1.0, 1.0, 1e2, 1e2, 1e2])
    assert plausible(marks, start, np.zeros(3), tiny) == [0, 1]     # a turn reconciles them
    stiff = np.diag([1e9, 1e9, 1e9, 1e2, 1e2, 1e2])
    assert plausible(marks, start, np.zeros(3), stiff) == []
    assert plausible(touched(2), start, np.zeros(3), stiff) == [0, 1]


def test_a_third_landmark_shows_which_of_two_is_the_mistake() -> None:
    stiff = np.diag([1e9, 1e9, 1e9, 1e2, 1e2, 1e2])
    assert plausible(touched(3, b=(0.0, 0.03, 0.0)), rigid.inverse(T_TRACKER_BONE), np.zeros(3),
                     stiff) == [0, 2]


def test_a_landmark_decides_between_poses_that_fit_the_points_alike() -> None:
    mesh = ellipsoid()
    field = field_of(mesh)
    assert register(points(mesh=mesh), field).reason is Reason.AMBIGUOUS
    found = register(points(mesh=mesh), field, landmarks=touched(1))
    assert found.success, found.message
    assert near_truth(found, 0.001, field)


@pytest.mark.parametrize('seed', range(3))
def test_a_wrong_landmark_does_not_lead_to_a_wrong_pose(seed: int) -> None:
    mesh = ellipsoid()
    field = field_of(mesh)
    off = 0.04 * rigid.rotation_exp(np.random.default_rng(seed).normal(size=3))[0]
    found = register(points(mesh=mesh), field, landmarks=touched(1, a=tuple(off)))
    assert found.reason is Reason.AMBIGUOUS
    found = register(points(mesh=mesh), field, landmarks=touched(3, b=tuple(off)))
    assert not found.success or near_truth(found, 0.001, field)


def test_landmarks_fix_a_turn_that_the_points_do_not_constrain() -> None:
    mesh = ball_mesh(np.array([0.03, 0.03, 0.055]))     # of revolution
    field = field_of(mesh)
    exact = Config.from_flat({'model.surface_error': 0.0})
    assert not register(points(mesh=mesh), field, exact).success
    found = register(points(mesh=mesh), field, exact, landmarks=touched(2, sigma=0.001))
    assert found.success, found.message
    assert near_truth(found, 0.001, field)
    assert found.predicted_tre_m['rms'] < 0.001


def test_a_pose_too_uncertain_where_it_is_required_is_accepted_with_landmarks() -> None:
    strict = Config.from_flat({'limits.max_error': 4.5e-4, 'limits.require': 'bone',
                               'limits.min_gap': 0.0})
    points_here = points(radius=0.035)
    alone = register(points_here, bone_field(), strict, T_tracker_bone=NEAR)
    fused = register(points_here, bone_field(), strict, landmarks=touched(4, sigma=2e-4),
                     T_tracker_bone=NEAR)
    assert alone.reason is Reason.UNDER_CONSTRAINED
    assert fused.success, fused.message
    assert near_truth(fused, 4.5e-4, bone_field())


@settings(max_examples=5, deadline=None)
@given(st.permutations(range(4)))
def test_the_order_of_the_landmarks_does_not_matter(order: list[int]) -> None:
    marks = touched(4, d=(0.03, 0.0, 0.0))
    one, other = (register(points(), bone_field(), FAST, landmarks=each, T_tracker_bone=NEAR)
                  for each in (marks, marks.rows(order)))
    np.testing.assert_allclose(other.T_tracker_bone, one.T_tracker_bone, atol=1e-9)
    assert {(fit.name, fit.used) for fit in one.landmarks} == {
        (fit.name, fit.used) for fit in other.landmarks}


@settings(max_examples=5, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_the_frame_of_the_tracker_does_not_matter(twist: list[float]) -> None:
    T, marks = rigid.exp(twist), touched(2)
    there = Landmarks.of(marks.model, rigid.transform(T, marks.touched), marks.sigmas)
    one = register(points(), bone_field(), FAST, landmarks=marks, T_tracker_bone=NEAR)
    other = register(rigid.transform(T, points()), bone_field(), FAST, landmarks=there,
                     T_tracker_bone=T @ NEAR)
    surface = np.asarray(bone_mesh().vertices)
    assert rigid.rms_displacement(T @ one.T_tracker_bone, other.T_tracker_bone, surface) < 2e-5
    assert other.predicted_tre_m['rms'] == pytest.approx(one.predicted_tre_m['rms'], rel=0.05)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3), st.permutations(range(4)))
def test_the_likelihood_falls_with_the_misfit_and_is_bounded(off: list[float],
                                                             order: list[int]) -> None:
    marks, T = touched(4), rigid.inverse(T_TRACKER_BONE)
    shifted = rigid.exp([0.0, 0.0, 0.0, *off]) @ T
    worse = log_likelihood(marks, shifted)
    assert -4 * 32.0 <= worse <= 0.0
    assert worse == pytest.approx(log_likelihood(marks.rows(order), shifted))
    if np.linalg.norm(off) > 0.05:
        assert worse < log_likelihood(marks, T)


def test_a_ball_tip_touches_a_landmark_with_its_centre() -> None:
    on_bone, inside = np.array([[0.034, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0]])
    on_bone = on_bone - bone_field().sample(on_bone)[0][:, None] * bone_field().sample(on_bone)[1]
    marks = Landmarks.of(np.concatenate([on_bone, inside]), np.zeros((2, 3)))
    assert for_tip(marks, bone_field()) is marks
    moved = for_tip(marks, bone_field().for_tip(0.0015))
    outward = bone_field().sample(on_bone)[1]
    np.testing.assert_allclose(moved.model[0], on_bone[0] + 0.0015 * outward[0], atol=2e-5)
    np.testing.assert_array_equal(moved.model[1], inside[0])
