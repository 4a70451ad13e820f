# SPDX-License-Identifier: Apache-2.0
"""`register` returns a pose with its accuracy or a reason; it never raises."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from smooth_bone import LANDMARKS, T_TRACKER_BONE, ball_mesh, bone_field, field_of, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.pipeline import register

TARGETS = Config.from_flat({'targets.names': ['tip', 'side'],
                            'targets.positions': [0.0, 0.0, 0.06, 0.03, 0.0, 0.0]})
NEAR = T_TRACKER_BONE @ rigid.exp([0.03, -0.02, 0.04, 0.002, -0.001, 0.002])
TOUCHED_LANDMARKS = rigid.transform(T_TRACKER_BONE, LANDMARKS) + 0.003 * np.diag([1.0, -1.0, 1.0])


def measured(n: int = 400, seed: int = 0, sigma: float = 3e-4, **more: Any) -> Array:
    return rigid.transform(T_TRACKER_BONE, touched_points(n, seed, sigma, **more))


def refused(result: RegistrationResult, *reasons: Reason) -> str:
    """Check that the result is a complete refusal and return its message."""
    assert result.reason in reasons, result.message
    assert not result.success
    assert result.T_tracker_bone is None and result.T_bone_tracker is None
    assert result.covariance is None
    assert re.fullmatch(r'\S[^\n]{20,500}', result.message)
    return result.message


def finite_numbers(value: Any) -> bool:
    """Return whether all numbers are finite, except for the residuals of points not used."""
    if dataclasses.is_dataclass(value):
        return all(finite_numbers(getattr(value, f.name)) for f in dataclasses.fields(value)
                   if f.name not in ('residuals_m', 'pitch_m_per_rad'))
    if isinstance(value, dict):
        return all(finite_numbers(v) for v in value.values())
    if isinstance(value, (tuple, list)):
        return all(finite_numbers(v) for v in value)
    return value is None or isinstance(value, (str, bool)) or bool(np.isfinite(value).all())


def test_landmarks_yield_a_pose_with_its_accuracy() -> None:
    result = register(measured(),
                      bone_field(),
                      TARGETS,
                      landmarks=(LANDMARKS, TOUCHED_LANDMARKS),
                      history=True)
    assert result.success and result.reason is Reason.CONVERGED
    offset = rigid.log(rigid.inverse(T_TRACKER_BONE) @ result.T_tracker_bone)
    assert np.linalg.norm(offset[:3]) < np.radians(1.0) and np.linalg.norm(offset[3:]) < 1e-3
    np.testing.assert_allclose(result.T_bone_tracker @ result.T_tracker_bone, np.eye(4), atol=1e-12)
    assert rigid.is_rigid(result.T_tracker_bone, 1e-12)
    assert (result.received, result.used) == (400, 400) and 350 <= result.inliers <= 400
    assert result.sigma_m == pytest.approx(3e-4, rel=0.2)
    assert result.residual_rms_m == pytest.approx(3e-4, rel=0.2)
    assert set(result.predicted_tre_m) == {'tip', 'side', 'rms', 'max'}
    assert 0.0 < result.predicted_tre_m['rms'] < result.predicted_tre_m['max'] < 2e-3
    np.testing.assert_allclose(result.covariance, result.covariance.T, atol=0.0)
    assert (np.linalg.eigvalsh(result.covariance) > 0.0).all()
    assert result.weakest_direction is not None
    assert result.weakest_direction.sentence in result.message
    assert len(result.history) == result.iterations > 0
    assert result.residuals_m.shape == result.weights.shape == (400,)
    assert ((result.weights >= 0.0) & (result.weights <= 1.0)).all()
    assert {'search', 'solve', 'total'} <= set(result.timing_s)
    assert all(v >= 0.0 for v in result.timing_s.values())
    assert finite_numbers(result)
    assert '\n' not in result.message


def test_accepts_an_initial_pose() -> None:
    result = register(measured(), bone_field(), T_tracker_bone=NEAR)
    assert result.success and result.history == ()
    from_lists = register(measured().tolist(), bone_field(), T_tracker_bone=NEAR.tolist())
    np.testing.assert_array_equal(from_lists.T_tracker_bone, result.T_tracker_bone)


def test_the_same_points_yield_identical_results() -> None:
    one, other = (register(measured(), bone_field(), T_tracker_bone=NEAR) for _ in range(2))
    assert one.T_tracker_bone.tobytes() == other.T_tracker_bone.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()
    assert one.message == other.message


def test_accepts_points_in_single_precision() -> None:
    result = register(measured().astype(np.float32), bone_field(), T_tracker_bone=NEAR)
    assert result.success
    offset = rigid.log(
        rigid.inverse(register(measured(), bone_field(), T_tracker_bone=NEAR).T_tracker_bone)
        @ result.T_tracker_bone)
    assert np.abs(offset).max() < 1e-5


@pytest.mark.parametrize(('points', 'reason', 'words'), [
    (measured(29), Reason.TOO_FEW_POINTS, 'too few points: 29'),
    (np.empty((0, 3)), Reason.TOO_FEW_POINTS, 'too few points: 0'),
    (measured(200, radius=0.008), Reason.REGION_TOO_SMALL, 'span'),
    (1e3 * measured(), Reason.WRONG_UNIT, 'unit'),
    (1e-3 * measured(), Reason.WRONG_UNIT, 'unit'),
    (np.vstack([measured(), [[np.nan, 0.0, 0.0]]]), Reason.BAD_INPUT,
     'not finite: 1 of 401 points'),
    (np.vstack([measured(), np.full((2, 3), np.inf)]), Reason.BAD_INPUT, '2 of 402'),
    (measured()[:, :2], Reason.BAD_INPUT, '(400, 2)'),
    (measured().ravel(), Reason.BAD_INPUT, '(1200,)'),
    ([[0.0, 1.0], [2.0]], Reason.BAD_INPUT, 'array of numbers'),
    (['a', 'b', 'c'], Reason.BAD_INPUT, 'array of numbers'),
    (None, Reason.BAD_INPUT, 'points'),
    (np.array(1.0), Reason.BAD_INPUT, 'points'),
    (object(), Reason.BAD_INPUT, 'points'),
],
                         ids=[
                             'few', 'none', 'small', 'mm', 'km', 'nan', 'inf', '2d', 'flat',
                             'ragged', 'words', 'None', 'scalar', 'object'
                         ])
def test_invalid_points_are_refused(points: Any, reason: Reason, words: str) -> None:
    assert words in refused(register(points, bone_field(), T_tracker_bone=NEAR), reason)


@pytest.mark.parametrize('guess', [2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.eye(3),
                                   np.full((4, 4), np.nan), 'here', [[1.0], [2.0, 3.0]]],
                         ids=['scaled', 'mirrored', '3x3', 'nan', 'word', 'ragged'])
def test_an_invalid_initial_pose_is_refused(guess: Any) -> None:
    refused(register(measured(), bone_field(), T_tracker_bone=guess), Reason.BAD_INPUT)


@pytest.mark.parametrize('landmarks', [
    (LANDMARKS[:2], TOUCHED_LANDMARKS[:2]), (LANDMARKS, TOUCHED_LANDMARKS[:2]),
    (LANDMARKS * 0.0, TOUCHED_LANDMARKS), (LANDMARKS, TOUCHED_LANDMARKS * np.nan), ('a', 'b')],
    ids=['two', 'unpaired', 'one place', 'nan', 'words'])
def test_invalid_landmarks_are_refused(landmarks: Any) -> None:
    refused(register(measured(), bone_field(), landmarks=landmarks), Reason.BAD_INPUT)


def test_random_points_are_refused() -> None:
    cloud = np.random.default_rng(0).uniform(-0.1, 0.1, (400, 3))
    refused(register(rigid.transform(T_TRACKER_BONE, cloud), bone_field(),
                     T_tracker_bone=NEAR), Reason.TOO_FEW_INLIERS, Reason.MODEL_MISMATCH,
            Reason.NOT_CONVERGED, Reason.UNDER_CONSTRAINED)


def test_points_off_the_bone_are_too_few_inliers() -> None:
    points = touched_points(400)
    _, outward = bone_field().sample(points)
    points[150:] += np.random.default_rng(0).uniform(0.01, 0.04, 250)[:, None] * outward[150:]
    strict = Config.from_flat({'limits.min_inliers': 0.5, 'solver.method': 'paper'})
    message = refused(register(rigid.transform(T_TRACKER_BONE, points), bone_field(), strict,
                               T_tracker_bone=T_TRACKER_BONE), Reason.TOO_FEW_INLIERS)
    assert re.search(r'\d+ of 400 points', message)


def test_noise_above_the_limit_is_a_model_mismatch() -> None:
    points = touched_points(400, 0, 1.5e-3)
    tracker = Config.from_flat({'limits.max_sigma': 5e-4, 'solver.cauchy_scale': 5e-3})
    result = register(rigid.transform(T_TRACKER_BONE, points),
                      bone_field(),
                      tracker,
                      T_tracker_bone=NEAR)
    assert 'mm' in refused(result, Reason.MODEL_MISMATCH)


def test_too_few_iterations_are_not_converged() -> None:
    hasty = Config.from_flat({'solver.max_iterations': 1})
    refused(register(measured(), bone_field(), hasty, T_tracker_bone=NEAR), Reason.NOT_CONVERGED)


def round_field(*radii: float) -> tuple[Any, Field]:
    mesh = ball_mesh(np.array(radii))
    return mesh, field_of(mesh, 0.002)


@pytest.mark.parametrize(('radii', 'radius'),
                         [((0.04, 0.04, 0.04), 1.0), ((0.04, 0.04, 0.04), 0.03),
                          ((0.04, 0.04, 0.055), 1.0)],
                         ids=['sphere', 'cap', 'spheroid'])
def test_a_surface_of_revolution_is_refused(radii: tuple[float, ...],
                                                    radius: float) -> None:
    mesh, field = round_field(*radii)
    points = rigid.transform(T_TRACKER_BONE, touched_points(400, 0, 5e-4, radius, mesh))
    refused(register(points, field, T_tracker_bone=NEAR), Reason.UNDER_CONSTRAINED,
            Reason.AMBIGUOUS)


def test_a_plane_is_under_constrained() -> None:
    plate = trimesh.creation.box((0.3, 0.25, 0.06)).subdivide_to_size(0.01)
    rng = np.random.default_rng(0)
    points = np.column_stack(
        [rng.uniform(-0.03, 0.03, (1000, 2)), 0.03 + 3e-4 * rng.normal(size=1000)])
    refused(
        register(rigid.transform(T_TRACKER_BONE, points),
                 field_of(plate, 0.002),
                 T_tracker_bone=NEAR), Reason.UNDER_CONSTRAINED, Reason.AMBIGUOUS)


any_number = st.floats(allow_nan=True, allow_infinity=True, width=64)
garbage = st.one_of(
    hnp.arrays(np.float64, hnp.array_shapes(max_dims=3, max_side=50), elements=any_number),
    hnp.arrays(np.float64, st.tuples(st.integers(30, 60), st.just(3)), elements=any_number),
    hnp.arrays(np.float64,
               st.tuples(st.integers(30, 60), st.just(3)),
               elements=st.floats(-0.1, 0.1)),
    hnp.arrays(np.float64,
               st.tuples(st.integers(30, 60), st.just(3)),
               elements=st.floats(-1e300, 1e300)),
    hnp.arrays(np.int16, st.tuples(st.integers(30, 60), st.just(3))),
    st.recursive(st.none() | st.text() | any_number, st.lists, max_leaves=20))


@given(garbage, st.sampled_from([NEAR, np.eye(4)]))
@settings(deadline=None, max_examples=150)
def test_arbitrary_points_do_not_raise(points: Any, guess: Array) -> None:
    with np.errstate(all='ignore'):
        result = register(points, bone_field(), T_tracker_bone=guess)
    if not result.success:
        refused(result, *set(Reason) - {Reason.CONVERGED})
    else:
        assert finite_numbers(result)


@given(garbage, garbage)
@settings(deadline=None, max_examples=50)
def test_arbitrary_landmarks_do_not_raise(model: Any, tracker: Any) -> None:
    with np.errstate(all='ignore'):
        result = register(measured(), bone_field(), landmarks=(model, tracker))
    assert isinstance(result.reason, Reason) and result.message


@pytest.mark.parametrize('landmarks', [(), 3, (LANDMARKS,), (LANDMARKS, 'a'), [1, 2, 3]])
def test_landmarks_of_another_form_are_refused(landmarks: Any) -> None:
    refused(register(measured(), bone_field(), landmarks=landmarks), Reason.BAD_INPUT)
