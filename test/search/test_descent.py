# SPDX-License-Identifier: Apache-2.0
"""The kernels of the search, compared with a plain numpy implementation, and their effect."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_bone import bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.field.sample import CELLS, NODES, FieldArrays
from gsdf_registration.search.descent import (
    _nearest,
    _normal_equations,
    gauss_newton_steps,
    start_costs,
)

LAW = settings(deadline=None, max_examples=20)
seeds = st.integers(0, 2**32 - 1)
SCALES = np.array([0.01, 0.01, 0.005, 0.005, 0.002, 0.002])


def centred(n: int = 150) -> tuple[Array, Array]:
    """Return points (n, 3) of the bone about their centroid, and the centroid."""
    points = touched_points(n)
    return points - points.mean(axis=0), points.mean(axis=0)


def columns(points: Array) -> np.ndarray:
    return np.ascontiguousarray(points.T, dtype=np.float32)


def reference_nearest(field: FieldArrays, fine: bool, x: Array) -> tuple[float, Array]:
    """Return distance and gradient from the plane of the nearest node."""
    edge = CELLS * field.voxel
    shape = np.array(field.block_of.shape)
    u = np.clip((x - field.origin) / edge, 0.0, shape)
    cell = np.minimum(u.astype(int), shape - 1)
    block = field.block_of[tuple(cell)]
    if fine and block >= 0:
        node = np.floor((u - cell) * CELLS + 0.5).astype(int)
        row = block * NODES**3 + np.ravel_multi_index(tuple(node), (NODES,) * 3)
        at = field.origin + cell * edge + node * field.voxel
    else:
        node = np.floor(u + 0.5).astype(int)
        row = field.first_coarse + np.ravel_multi_index(tuple(node), tuple(shape + 1))
        at = field.origin + node * edge
    d, *gradient = field.nodes[row].astype(np.float64)
    return d + np.dot(gradient, x - at), np.array(gradient)


@pytest.mark.parametrize('fine', [False, True])
@pytest.mark.parametrize('offset', [0.001, 0.01, 1.0], ids=['near', 'inside', 'far outside'])
def test_distance_comes_from_the_nearest_node(fine: bool, offset: float) -> None:
    field = bone_field()
    rng = np.random.default_rng(0)
    points = rng.choice(field.surface_points, 300) + offset * rng.uniform(-1.0, 1.0, (300, 3))
    for x in points.astype(np.float64):
        d, *gradient = _nearest(field.arrays, fine, *(x - field.arrays.origin).astype(np.float32))
        expected, g = reference_nearest(field.arrays, fine, x)
        # halfway between two nodes, either may be used
        tolerance = 2e-6 if np.allclose(g, gradient) else 0.1 * offset + 5e-4
        assert d == pytest.approx(expected, abs=tolerance)


def test_fine_nodes_are_accurate_near_the_surface() -> None:
    field = bone_field()
    rng = np.random.default_rng(0)
    points = rng.choice(field.surface_points, 500) + 1e-3 * rng.normal(size=(500, 3))
    exact, _ = field.sample(points)
    x = (points - field.arrays.origin).astype(np.float32)
    found = np.array([_nearest(field.arrays, True, *p)[0] for p in x])
    assert np.sqrt(np.mean((found - exact)**2)) < 3e-5


@pytest.mark.parametrize('fine', [False, True])
@pytest.mark.parametrize('n', [1, 7, 16, 40, 150], ids=str)
def test_normal_equations_agree_with_numpy(fine: bool, n: int) -> None:
    field, (points, centroid) = bone_field().arrays, centred(150)
    points = points[:n]
    T = rigid.exp([0.1, -0.05, 0.08, 0.002, 0.001, -0.003])
    R, t, c2 = T[:3, :3].copy(), centroid + T[:3, 3], 0.005**2
    A, b = np.zeros((6, 6)), np.zeros(6)
    _normal_equations(field, fine, columns(points), R, t, np.float32(c2), A, b)
    expected_A, expected_b = np.zeros((6, 6)), np.zeros(6)
    for p in points.astype(np.float32).astype(np.float64):
        d, g = reference_nearest(field, fine, R @ p + t)
        J = np.concatenate([np.cross(R @ p, g), g])
        w = (c2 / (c2 + d * d))**2
        expected_A += w * np.outer(J, J)
        expected_b -= w * d * J
    np.testing.assert_allclose(A, np.tril(expected_A), rtol=1e-3, atol=1e-4 * n)
    np.testing.assert_allclose(b, expected_b, atol=1e-5 * n)


@LAW
@given(seeds)
def test_converges_from_a_nearby_pose(seed: int) -> None:
    points, centroid = centred()
    rng = np.random.default_rng(seed)
    axis, direction = rng.normal(size=3), rng.normal(size=3)
    R = rigid.rotation_exp(0.15 * axis / np.linalg.norm(axis))[None].copy()
    t = (centroid + 0.005 * direction / np.linalg.norm(direction))[None]
    cost = np.zeros(1)
    gauss_newton_steps(bone_field().arrays, True, columns(points), R, t, SCALES, cost)
    moved = points @ R[0].T + t[0] - (points + centroid)
    assert np.sqrt((moved**2).sum(axis=1).mean()) < 5e-4
    assert rigid.is_rigid(rigid.from_rt(R[0], t[0]), 1e-9) and 0.0 <= cost[0] < 0.05


def test_cost_is_the_mean_geman_mcclure_cost() -> None:
    points, centroid = centred()
    field, R, t, cost = bone_field(), np.eye(3)[None].copy(), (centroid + 0.002)[None], np.zeros(1)
    gauss_newton_steps(field.arrays, True, columns(points), R, t, SCALES[:1], cost)
    e = field.sample(points @ R[0].T + t[0])[0]
    assert cost[0] == pytest.approx(np.mean(e**2 / (e**2 + SCALES[0]**2)), rel=0.1)


def test_poses_do_not_affect_each_other() -> None:
    points, centroid = centred(40)
    rng = np.random.default_rng(0)
    R = np.array([rigid.rotation_exp(rng.normal(size=3)) for _ in range(10)])
    t = centroid + 0.01 * rng.normal(size=(10, 3))
    together = R.copy(), t.copy(), np.zeros(10)
    gauss_newton_steps(bone_field().arrays, False, columns(points), *together[:2], SCALES,
                       together[2])
    for k in range(10):
        alone = R[k:k + 1].copy(), t[k:k + 1].copy(), np.zeros(1)
        gauss_newton_steps(bone_field().arrays, False, columns(points), *alone[:2], SCALES,
                           alone[2])
        for a, b in zip(alone, together):
            np.testing.assert_array_equal(a[0], b[k])


@pytest.mark.parametrize('n', [1, 2, 3])
def test_pose_stays_finite_with_too_few_points(n: int) -> None:
    points, centroid = centred(40)
    R, t, cost = np.eye(3)[None].copy(), centroid[None].copy(), np.zeros(1)
    gauss_newton_steps(bone_field().arrays, True, columns(points[:n]), R, t, SCALES, cost)
    assert np.isfinite(R).all() and np.isfinite(t).all() and np.isfinite(cost).all()


def test_true_start_has_the_lowest_cost() -> None:
    points, centroid = centred(16)
    rng = np.random.default_rng(0)
    rotations = np.array([rigid.rotation_exp(w) for w in 2.0 * rng.normal(size=(20, 3))])
    places = bone_field().surface_points[rng.integers(0, 1000, 10)].astype(np.float64)
    rotations[7], places[4] = np.eye(3), centroid
    kept = rotations.copy(), places.copy()
    cost = np.full(200, np.nan)
    start_costs(bone_field().arrays, columns(points), rotations, places, 0.02, cost)
    assert np.isfinite(cost).all() and np.argmin(cost) == 7 * 10 + 4
    np.testing.assert_array_equal(rotations, kept[0])
    np.testing.assert_array_equal(places, kept[1])


@pytest.mark.parametrize('distance', [1.0, 1e3, 1e6])
def test_far_points_and_poses_stay_finite(distance: float) -> None:
    points, centroid = centred(40)
    points[0] *= distance
    R = np.tile(np.eye(3), (5, 1, 1))
    t = centroid + distance * np.random.default_rng(0).normal(size=(5, 3))
    cost = np.zeros(5)
    gauss_newton_steps(bone_field().arrays, True, columns(points), R, t, SCALES, cost)
    assert np.isfinite(R).all() and np.isfinite(t).all() and np.isfinite(cost).all()
