# SPDX-License-Identifier: Apache-2.0
"""Test the functions for rigid motions, including numerically critical cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array

PROPERTY = settings(deadline=None, max_examples=100)


def numbers(limit: float, count: int) -> st.SearchStrategy[Array]:
    number = st.floats(-limit, limit, allow_nan=False, allow_infinity=False)
    return st.lists(number, min_size=count, max_size=count).map(np.array)


# rotations up to 0.999 pi, so that the logarithm is unique
rotations = numbers(1.0, 3).map(lambda v: v * 0.999 * np.pi / max(1.0, float(np.linalg.norm(v))))
twists = st.tuples(rotations, numbers(2.0, 3)).map(np.concatenate)
points = numbers(1.0, 15).map(lambda v: v.reshape(5, 3))


@given(twists)
@PROPERTY
def test_exp_equals_the_matrix_exponential(twist: Array) -> None:
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = rigid.skew(twist[:3]), twist[3:]
    np.testing.assert_allclose(rigid.exp(twist), expm(generator), atol=1e-12)


@given(twists)
@PROPERTY
def test_log_is_the_inverse_of_exp(twist: Array) -> None:
    np.testing.assert_allclose(rigid.log(rigid.exp(twist)), twist, atol=1e-11)


@given(numbers(1.0, 6), st.integers(3, 16))
@PROPERTY
def test_log_is_accurate_for_small_motions(twist: Array, exponent: int) -> None:
    twist = twist * 10.0**-exponent
    # the absolute precision of a rotation matrix is 1e-16
    np.testing.assert_allclose(rigid.log(rigid.exp(twist)), twist, rtol=1e-9, atol=3e-16)


@pytest.mark.parametrize('angle', [0.0, 1e-12, 1e-8, 0.00999, 0.01001, 1.0, np.pi - 1e-9, np.pi])
def test_rotation_exp_is_a_proper_rotation_for_any_angle(angle: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    R = rigid.rotation_exp(angle * axis)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
    assert np.linalg.norm(rigid.rotation_log(R)) == pytest.approx(angle, abs=1e-12)


@given(twists, twists, points)
@PROPERTY
def test_transform_of_a_product_is_the_composition(ab: Array, bc: Array, x_c: Array) -> None:
    T_a_b, T_b_c = rigid.exp(ab), rigid.exp(bc)
    np.testing.assert_allclose(rigid.transform(T_a_b @ T_b_c, x_c),
                               rigid.transform(T_a_b, rigid.transform(T_b_c, x_c)), atol=1e-13)


@given(twists, points)
@PROPERTY
def test_inverse_reverses_a_transform(twist: Array, x: Array) -> None:
    T = rigid.exp(twist)
    np.testing.assert_allclose(rigid.transform(rigid.inverse(T), rigid.transform(T, x)),
                               x,
                               atol=1e-13)
    np.testing.assert_array_equal(rigid.inverse(T)[:3, :3], T[:3, :3].T)


@given(twists, points)
@PROPERTY
def test_fit_points_is_exact_without_noise(twist: Array, b: Array) -> None:
    b = b + [[0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 5], [0, 0, 0]]     # never nearly collinear
    T = rigid.exp(twist)
    np.testing.assert_allclose(rigid.fit_points(rigid.transform(T, b), b), T, atol=1e-12)


@given(twists)
@PROPERTY
def test_fit_points_is_exact_for_three_points(twist: Array) -> None:
    b = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.05, 0.0]])
    T = rigid.exp(twist)
    np.testing.assert_allclose(rigid.fit_points(rigid.transform(T, b), b), T, atol=1e-12)


@given(twists)
@PROPERTY
def test_fit_points_returns_a_proper_rotation_for_mirrored_points(twist: Array) -> None:
    b = np.random.default_rng(3).normal(size=(8, 3)) * [1.0, 2.0, 3.0]
    a = rigid.transform(rigid.exp(twist), b * [-1.0, 1.0, 1.0])
    T = rigid.fit_points(a, b)
    assert rigid.is_rigid(T, 1e-12)
    expected, _ = Rotation.align_vectors(a - a.mean(axis=0), b - b.mean(axis=0))
    np.testing.assert_allclose(T[:3, :3], expected.as_matrix(), atol=1e-9)


@pytest.mark.parametrize(('a', 'b'), [((2, 3), (2, 3)), ((4, 3), (5, 3)), ((4, 2), (4, 2)),
                                      ((3, ), (3, ))])
def test_fit_points_rejects_different_shapes(a: tuple[int, ...], b: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match='shape'):
        rigid.fit_points(np.zeros(a), np.zeros(b))


@given(rotations)
@PROPERTY
def test_quaternions_agree_with_scipy_and_are_invertible(w: Array) -> None:
    R = rigid.rotation_exp(w)
    q = rigid.quaternion_from_rotation(R)
    assert q[3] >= 0.0
    expected = Rotation.from_matrix(R).as_quat()
    np.testing.assert_allclose(q, expected * np.sign(expected @ q), atol=1e-12)
    np.testing.assert_allclose(rigid.rotation_from_quaternion(q), R, atol=1e-13)


@given(numbers(1.0, 3))
@PROPERTY
def test_quaternions_of_half_turns_are_accurate(v: Array) -> None:
    axis = (v + [0.0, 0.0, 1e-3]) / np.linalg.norm(v + [0.0, 0.0, 1e-3])
    R = 2.0 * np.outer(axis, axis) - np.eye(3)
    q = rigid.quaternion_from_rotation(R)
    np.testing.assert_allclose(rigid.rotation_from_quaternion(q), R, atol=1e-12)
    assert rigid.angle_between(np.eye(3), R) == pytest.approx(np.pi, abs=1e-12)


@pytest.mark.parametrize('q',
                         [[0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0], [np.inf, 0.0, 0.0, 1.0]])
def test_rejects_a_quaternion_that_is_zero_or_not_finite(q: list[float]) -> None:
    with pytest.raises(ValueError, match='zero length'):
        rigid.rotation_from_quaternion(q)


@given(twists, numbers(1e-3, 9))
@PROPERTY
def test_orthonormalized_is_rigid_near_and_idempotent(twist: Array, noise: Array) -> None:
    T = rigid.exp(twist)
    T[:3, :3] += noise.reshape(3, 3)
    nearest = rigid.orthonormalized(T)
    assert rigid.is_rigid(nearest, 1e-12)
    assert np.abs(nearest - T).max() <= 4e-3
    np.testing.assert_allclose(rigid.orthonormalized(nearest), nearest, atol=1e-14)


@pytest.mark.parametrize('T', [
    np.eye(3),
    np.diag([1.0, 1.0, -1.0, 1.0]),
    np.diag([2.0, 2.0, 2.0, 1.0]),
    np.full((4, 4), np.nan),
    np.vstack([np.eye(4)[:3], [0.1, 0.0, 0.0, 1.0]]),
], ids=['3x3', 'mirrored', 'scaled', 'nan', 'projective'])
def test_is_rigid_rejects_other_matrices(T: Array) -> None:
    assert rigid.is_rigid(np.eye(4))
    assert not rigid.is_rigid(T)
