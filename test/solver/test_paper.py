# SPDX-License-Identifier: Apache-2.0
"""The published solver: convergence, outliers, and invariances."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver import Solution, gauss_newton, local_solver, solve
from gsdf_registration.solver.paper import DISCARD_BELOW, algorithm_1

PAPER = SolverConfig(method='paper')
LAW = settings(deadline=None, max_examples=15)
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
seeds = st.integers(0, 10**6)


@contextmanager
def parameters(**values: float) -> Iterator[None]:
    """Set parameters of Algorithm 1."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in values.items():
            patch.setattr(local_solver, name, value)
        yield


def near(seed: int, degrees: float = 3.0, metres: float = 0.003) -> Array:
    """Return an initial pose with this error."""
    rng = np.random.default_rng(seed)
    axis, way = rng.normal(size=3), rng.normal(size=3)
    axis, way = axis / np.linalg.norm(axis), way / np.linalg.norm(way)
    return rigid.exp(np.concatenate([np.radians(degrees) * axis, metres * way])) @ T_BONE_TRACKER


def in_tracker(points: Array, T_tracker_bone: Array = T_TRACKER_BONE) -> Array:
    return rigid.transform(T_tracker_bone, points)


def difference(a: Array, b: Array) -> float:
    """Return the maximum distance between corners of the bone placed by two poses, m."""
    corners = np.vstack([bone_field().bounds, np.zeros(3)])
    a, b = rigid.inverse(a), rigid.inverse(b)
    return float(
        np.linalg.norm(rigid.transform(a, corners) - rigid.transform(b, corners), axis=1).max())


def mixed(n: int = 400, outliers: int = 60, seed: int = 0) -> Array:
    """Return noisy points, the last of them 4-15 mm off the bone; tracker frame."""
    points = touched_points(n, seed, 3e-4)
    _, gradient = bone_field().sample(points)
    off = np.random.default_rng(seed).uniform(0.004, 0.015, outliers)
    points[n - outliers:] += off[:, None] * gradient[n - outliers:]
    return in_tracker(points)


def test_stays_at_the_true_pose_without_noise() -> None:
    for seed in range(5):
        solution = solve(in_tracker(touched_points(500, seed)), bone_field(), T_BONE_TRACKER, PAPER)
        assert solution.converged
        # a field with 1 mm voxels has errors of a few um at the edges of triangles
        assert difference(solution.T_bone_tracker, T_BONE_TRACKER) < 5e-6


@given(seeds)
@LAW
def test_converges_from_a_nearby_pose(seed: int) -> None:
    points = in_tracker(touched_points(500, seed % 10))
    solution = solve(points, bone_field(), near(seed), PAPER)
    assert solution.converged and solution.termination == 'converged'
    assert difference(solution.T_bone_tracker, T_BONE_TRACKER) < 2e-5
    distance, _ = bone_field().sample(rigid.transform(solution.T_bone_tracker, points))
    np.testing.assert_allclose(solution.residuals, distance, atol=1e-9)


@pytest.mark.parametrize('way', [[0.3, 0.0, 0.0], [0.0, 0.0, -0.3], [0.18, -0.17, 0.17],
                                 [-0.18, -0.17, -0.17]])
def test_converges_from_300_mm_away_with_a_wide_weight(way: list[float]) -> None:
    away = rigid.exp([0.0, 0.0, 0.0, *way]) @ T_BONE_TRACKER
    points = in_tracker(touched_points(600, radius=1.0))
    wide = dataclasses.replace(PAPER, cauchy_scale=0.05)
    with parameters(DISCARD_BELOW=0.0, WEIGHT_TOLERANCE=1e-6):
        near_by = solve(points, bone_field(), away, wide)
    solution = solve(points, bone_field(), near_by.T_bone_tracker, PAPER)
    assert difference(solution.T_bone_tracker, T_BONE_TRACKER) < 2e-5


def test_weights_are_cauchy_weights() -> None:
    points = mixed()
    solution = solve(points, bone_field(), near(1), PAPER)
    kept = solution.weights > 0.0
    distance, _ = bone_field().sample(rigid.transform(solution.T_bone_tracker, points))
    np.testing.assert_allclose(solution.weights[kept],
                               1.0 / (1.0 + (distance[kept] / 1e-3)**2),
                               atol=1e-6)
    assert (solution.weights[kept] >= DISCARD_BELOW).all()
    # d(w e)/de of the Cauchy weight
    u = (distance[kept] / 1e-3)**2
    np.testing.assert_allclose(solution.curvature[kept], (1.0 - u) / (1.0 + u)**2, atol=1e-6)


def test_discards_only_outliers() -> None:
    solution = solve(mixed(400, 60), bone_field(), near(2), PAPER)
    discarded = np.isnan(solution.residuals)
    assert discarded[340:].all()
    assert discarded[:340].sum() <= 3
    assert (solution.weights[discarded] == 0.0).all() and (solution.curvature[discarded]
                                                           == 0.0).all()
    assert difference(solution.T_bone_tracker, T_BONE_TRACKER) < 1e-3


def test_discarded_points_stay_discarded() -> None:
    # stop after one iteration, two, three...: the set of discarded points only grows
    points = mixed(400, 60)
    centre = points.mean(axis=0)
    n = len(points)
    guess = near(3, 4.0, 0.006)
    kept = []
    for steps in range(1, 30):
        R, t = np.ascontiguousarray(guess[:3, :3]), rigid.transform(guess, centre)
        keep, weight = np.ones(n, dtype=np.bool_), np.zeros(n)
        algorithm_1(bone_field().arrays, points - centre, R, t, keep, weight, np.zeros(n),
                    np.zeros((n, 6)), gauss_newton.empty_history(steps), 1e-3, 0.1, 1e-3, 2)
        kept.append(keep)
    assert kept[-1].sum() < n
    for earlier, later in zip(kept[:-1], kept[1:]):
        assert not (later & ~earlier).any()


def test_delta_zero_discards_no_point() -> None:
    with parameters(DISCARD_BELOW=0.0):
        solution = solve(mixed(), bone_field(), near(4), PAPER)
    assert (solution.weights > 0.0).all() and np.isfinite(solution.residuals).all()


def test_convergence_must_hold_in_consecutive_iterations() -> None:
    iterations = []
    for hold in (1, 2, 3, 5):
        with parameters(HOLD=hold, DISCARD_BELOW=0.0):
            solution = solve(in_tracker(touched_points(300, 1, 3e-4)), bone_field(), near(5), PAPER)
        iterations.append(solution.iterations)
    assert np.diff(iterations).tolist() == [1, 1, 2]


def test_reports_why_it_stopped() -> None:
    points = in_tracker(touched_points(300, 1, 3e-4))
    short = solve(points, bone_field(), near(5), dataclasses.replace(PAPER, max_iterations=2))
    assert (short.converged, short.iterations) == (False, 2)
    assert short.termination == 'the maximum number of iterations was reached'
    # 0.1 m off every point is discarded
    lost = solve(points, bone_field(),
                 rigid.exp([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]) @ T_BONE_TRACKER, PAPER)
    assert (lost.converged, lost.termination) == (False, 'the points do not constrain the pose')


def test_history_has_a_row_per_iteration_and_decreasing_cost() -> None:
    points = in_tracker(touched_points(500, 2, 3e-4))
    solution = solve(points, bone_field(), near(6), PAPER, history=True)
    assert len(solution.history) == solution.iterations > 2
    assert solve(points, bone_field(), near(6), PAPER).history == ()
    # reweighting may raise the cost a little from one iteration to the next
    cost = [row.cost for row in solution.history if row.inliers == 500]
    assert cost[-1] < cost[0]
    steps = [row.rotation_step for row in solution.history]
    assert steps[-1] < 0.05 * steps[0]
    assert all(row.translation_step >= 0.0 and 0 < row.inliers <= 500 for row in solution.history)


@given(seeds)
@LAW
def test_is_invariant_under_rigid_motion(seed: int) -> None:
    """
    Registering T X gives the pose T T_tracker_bone: the tracker may stand anywhere.
    """
    rng = np.random.default_rng(seed)
    T = rigid.exp(np.concatenate([rng.uniform(-1.5, 1.5, 3), rng.uniform(-2.0, 2.0, 3)]))
    points, guess = mixed(seed=seed % 10), near(seed)
    here = solve(points, bone_field(), guess, PAPER)
    there = solve(rigid.transform(T, points), bone_field(), guess @ rigid.inverse(T), PAPER)
    assert difference(there.T_bone_tracker @ T, here.T_bone_tracker) < 1e-9
    np.testing.assert_allclose(there.weights, here.weights, atol=1e-7)


@given(seeds)
@LAW
def test_is_invariant_to_the_order_of_the_points(seed: int) -> None:
    points = mixed(seed=seed % 10)
    order = np.random.default_rng(seed).permutation(len(points))
    one = solve(points, bone_field(), near(seed), PAPER)
    other = solve(points[order], bone_field(), near(seed), PAPER)
    assert difference(one.T_bone_tracker, other.T_bone_tracker) < 1e-9
    np.testing.assert_allclose(other.weights, one.weights[order], atol=1e-7)


def scaled_solution(factor: float, seed: int) -> Solution:
    """
    Return the solution with all lengths of bone, points, pose and settings in another unit.
    """
    field = bone_field()
    nodes = field.arrays.nodes.copy()
    nodes[:, 0] *= np.float32(factor)
    arrays = field.arrays._replace(origin=field.arrays.origin * factor,
                                   voxel=field.arrays.voxel * factor,
                                   nodes=nodes)
    guess = near(seed)
    guess[:3, 3] *= factor
    config = dataclasses.replace(PAPER, cauchy_scale=PAPER.cauchy_scale * factor)
    return solve(factor * mixed(seed=seed % 10), dataclasses.replace(field, arrays=arrays), guess,
                 config)


@given(seeds, st.sampled_from([1000.0, 1e-3, 4.0]))
@LAW
def test_is_invariant_to_the_unit_of_length(seed: int, factor: float) -> None:
    metres, other = scaled_solution(1.0, seed), scaled_solution(factor, seed)
    T = other.T_bone_tracker.copy()
    T[:3, 3] /= factor
    assert difference(T, metres.T_bone_tracker) < 1e-9 * bone_field().extent * 10
    assert other.iterations == metres.iterations
    kept = metres.weights > 0.0
    np.testing.assert_allclose(other.residuals[kept],
                               factor * metres.residuals[kept],
                               atol=factor * 1e-9)


def test_is_deterministic_in_many_threads() -> None:
    points = mixed()
    first = solve(points, bone_field(), near(7), PAPER)
    with ThreadPoolExecutor(4) as pool:
        others = list(pool.map(lambda _: solve(points, bone_field(), near(7), PAPER), range(16)))
    for other in [*others, solve(points, bone_field(), near(7), PAPER)]:
        for name in ('T_bone_tracker', 'weights', 'residuals', 'jacobian'):
            assert getattr(other, name).tobytes() == getattr(first, name).tobytes()


def test_does_not_modify_its_input() -> None:
    points, guess = mixed(), near(8)
    before = points.copy(), guess.copy()
    solve(points, bone_field(), guess, PAPER)
    np.testing.assert_array_equal(points, before[0])
    np.testing.assert_array_equal(guess, before[1])
