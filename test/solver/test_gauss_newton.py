# SPDX-License-Identifier: Apache-2.0
"""Gauss-Newton kernels, compared with finite differences, numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from smooth_bone import bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.field.sample import FieldArrays
from gsdf_registration.solver.centroid_frame import from_centroid_frame, to_centroid_frame
from gsdf_registration.solver.gauss_newton import (
    linearize,
    normal_equations,
    solve_cholesky,
    step_lengths,
    update,
)

LAW = settings(deadline=None, max_examples=30)
seeds = st.integers(0, 2**32 - 1)


def paraboloid() -> FieldArrays:
    """Return fine nodes filling a box, with a quadratic that the samples reproduce exactly."""
    voxel, blocks = 0.01, 5
    origin = np.full(3, -0.1)
    corner = np.stack(np.indices((blocks,) * 3), axis=-1).reshape(-1, 3) * 4
    node = corner[:, None] + np.stack(np.indices((5, 5, 5)), axis=-1).reshape(-1, 3)
    coarse = np.stack(np.indices((blocks + 1,) * 3), axis=-1).reshape(-1, 3) * 4
    x = origin + np.concatenate([node.reshape(-1, 3), coarse]) * voxel
    gradient = np.array([0.6, -0.64, 0.48]) + x @ QUADRATIC
    value = x @ [0.6, -0.64, 0.48] + 0.5 * np.einsum('ni,ij,nj->n', x, QUADRATIC, x)
    nodes = np.column_stack([value, gradient]).astype(np.float32)
    block_of = np.arange(blocks**3, dtype=np.int32).reshape((blocks,) * 3)
    return FieldArrays(origin, voxel, block_of, nodes, blocks**3 * 125)


QUADRATIC = np.diag([0.5, -0.3, 0.2])


def pose_of(seed: int, size: float = 1.0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    T = rigid.exp(np.concatenate([rng.normal(size=3), 0.01 * rng.normal(size=3)]) * size)
    return np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy()


def linearized(field: FieldArrays, points: Array, R: Array, t: Array) -> tuple[Array, Array]:
    e, J = np.zeros(len(points)), np.zeros((len(points), 6))
    linearize(field, points, R, t, np.ones(len(points), dtype=np.bool_), e, J)
    return e, J


def moved(R: Array, t: Array, dx: Array) -> tuple[Array, Array]:
    R, t = R.copy(), t.copy()
    update(R, t, dx)
    return R, t


def derivative(field: FieldArrays, points: Array, R: Array, t: Array, step: float) -> Array:
    """Return the central differences of the residuals along `update`, (n, 6)."""
    columns = []
    for axis in np.eye(6):
        ahead, _ = linearized(field, points, *moved(R, t, step * axis))
        behind, _ = linearized(field, points, *moved(R, t, -step * axis))
        columns.append((ahead - behind) / (2.0 * step))
    return np.stack(columns, axis=1)


@given(seeds)
@LAW
def test_jacobian_is_the_derivative_of_the_residual_along_update(seed: int) -> None:
    field = paraboloid()
    points = np.random.default_rng(seed).uniform(-0.04, 0.04, (50, 3))
    R, t = pose_of(seed)
    _, J = linearized(field, points, R, t)
    numeric = derivative(field, points, R, t, 1e-3)
    # the field normalizes the gradient: the direction is the same, the length is not
    norm = np.linalg.norm(numeric[:, 3:], axis=1, keepdims=True)
    np.testing.assert_allclose(J, numeric / norm, atol=2e-4)


@given(seeds)
@LAW
def test_jacobian_is_the_derivative_on_a_bone(seed: int) -> None:
    points = touched_points(200, seed % 20)
    centre = points.mean(axis=0)
    R, _ = pose_of(seed, 0.01)
    points, t = points - centre, centre.copy()
    _, J = linearized(bone_field().arrays, points, R, t)
    numeric = derivative(bone_field().arrays, points, R, t, 1e-5)
    # lever arms are 0.04 m; triangles and voxels of 1 mm leave errors of a few % at some points
    error = np.abs(J - numeric) / np.array([0.04] * 3 + [1.0] * 3)
    assert np.median(error) < 5e-3
    assert np.percentile(error, 99) < 0.1


@given(seeds)
@LAW
def test_update_is_the_matrix_exponential(seed: int) -> None:
    R, t = pose_of(seed)
    dx = np.random.default_rng(seed).normal(size=6)
    R_new, t_new = moved(R, t, dx)
    np.testing.assert_allclose(R_new, expm(rigid.skew(dx[:3])) @ R, atol=1e-12)
    np.testing.assert_allclose(t_new, t + dx[3:], atol=1e-15)
    assert step_lengths(dx) == pytest.approx((np.linalg.norm(dx[:3]), np.linalg.norm(dx[3:])))


@given(seeds)
@LAW
def test_centroid_frame_represents_the_same_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, 3)) + rng.normal(size=3)
    T = rigid.exp(rng.normal(size=6))
    inaccurate = T.copy()
    inaccurate[:3, :3] += 1e-6 * rng.normal(size=(3, 3))     # as an initial pose may be
    centred, centroid, R, t = np.empty((20, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    to_centroid_frame(points, inaccurate, centred, centroid, R, t)
    np.testing.assert_allclose(centred @ R.T + t, rigid.transform(T, points), atol=1e-4)
    np.testing.assert_allclose(centred.mean(axis=0), 0.0, atol=1e-14)
    back = np.empty((4, 4))
    from_centroid_frame(centroid, R, t, back)
    assert rigid.is_rigid(back, 1e-14)
    np.testing.assert_allclose(rigid.transform(back, points), centred @ R.T + t, atol=1e-11)
    np.testing.assert_allclose(back[:3, :3], rigid.orthonormalized(inaccurate)[:3, :3], atol=1e-11)


def test_zero_step_changes_nothing() -> None:
    R, t = pose_of(1)
    R_new, t_new = moved(R, t, np.zeros(6))
    np.testing.assert_array_equal(R_new, R)
    np.testing.assert_array_equal(t_new, t)


def test_rotation_stays_orthonormal_after_a_thousand_steps() -> None:
    R, t = pose_of(2)
    for dx in 0.1 * np.random.default_rng(0).normal(size=(1000, 6)):
        update(R, t, dx)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


def test_linearize_skips_points_that_are_not_kept() -> None:
    points = touched_points(50)
    keep = np.arange(50) % 2 == 0
    e, J = np.full(50, 7.0), np.full((50, 6), 7.0)
    linearize(bone_field().arrays, points, np.eye(3), np.zeros(3), keep, e, J)
    assert (e[~keep] == 7.0).all() and (J[~keep] == 7.0).all()
    assert (np.abs(e[keep]) < 1e-3).all()


@given(seeds, st.integers(6, 300))
@LAW
def test_normal_equations_agree_with_numpy(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    J, e = rng.normal(size=(n, 6)), rng.normal(size=n)
    w = rng.random(n) * (rng.random(n) > 0.2)
    A, b = np.full((6, 6), np.nan), np.full(6, np.nan)
    cost = normal_equations(J, e, w, A, b)
    np.testing.assert_allclose(np.tril(A), np.tril((J.T * w) @ J), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(b, -(J.T * w) @ e, rtol=1e-12, atol=1e-12)
    assert cost == pytest.approx((w * e**2).sum())


def test_nan_residual_is_ignored_at_weight_zero() -> None:
    rng = np.random.default_rng(0)
    J, e, w = rng.normal(size=(20, 6)), rng.normal(size=20), np.ones(20)
    e[3], J[3], w[3] = np.nan, np.nan, 0.0
    A, b = np.zeros((6, 6)), np.zeros(6)
    assert np.isfinite(normal_equations(J, e, w, A, b))
    assert np.isfinite(np.tril(A)).all() and np.isfinite(b).all()


def spd(seed: int, units: Array) -> tuple[Array, Array]:
    """Return a well-conditioned system with its unknowns in the given units."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(40, 6)) * units
    return J.T @ J, rng.normal(size=6) * units


@given(seeds, st.sampled_from([1.0, 1e-3, 1e3, 1e-6]))
@LAW
def test_cholesky_agrees_with_numpy_in_any_unit(seed: int, unit: float) -> None:
    A, b = spd(seed, np.array([unit] * 3 + [1.0] * 3))
    x = np.zeros(6)
    assert solve_cholesky(np.tril(A), b, x)
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-9)


@given(seeds, st.sampled_from([1.0, 1e-3, 1e3, 1e-6]))
@LAW
def test_cholesky_detects_a_singular_system_in_any_unit(seed: int, unit: float) -> None:
    # one motion is unconstrained, as rotation about the axis of a cylinder
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(40, 6))
    free = rng.choice([-1.0, 1.0], (6, 1)) * rng.uniform(0.3, 1.0, (6, 1))
    free /= np.linalg.norm(free)
    J = (J - (J @ free) @ free.T) * np.array([unit] * 3 + [1.0] * 3)
    assert not solve_cholesky(np.tril(J.T @ J), J.T @ np.ones(40), np.zeros(6))


def test_zero_matrix_is_singular() -> None:
    assert not solve_cholesky(np.zeros((6, 6)), np.zeros(6), np.zeros(6))
