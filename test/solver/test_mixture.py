# SPDX-License-Identifier: Apache-2.0
"""The mixture solver: formulas, convergence, warm start, and invariances."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit
from scipy.stats import norm
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver import (
    Estimates,
    Neighbourhood,
    Solution,
    local_solver,
    nearest_neighbours,
    refine,
    solve,
)
from gsdf_registration.solver.mixture import (
    INTERFERENCE_RANGE,
    OUTLIER_EXCESS,
    OUTSIDE_SHARE,
    _expectation,
    _log_likelihood,
    _observed_information,
    _white_noise,
    local_means,
)

CONFIG = SolverConfig()
LAW = settings(deadline=None, max_examples=15)
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
seeds = st.integers(0, 10**6)


def moved(T: Array, seed: int, degrees: float, metres: float, about: Array) -> Array:
    """Return ``T`` after a rotation about a point of the tracker frame and a translation."""
    rng = np.random.default_rng(seed)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = rigid.from_rt(rigid.rotation_exp(np.radians(degrees) * axis), np.zeros(3))
    there = rigid.from_rt(np.eye(3), about + metres * way)
    return np.asarray(T @ there @ turn @ rigid.from_rt(np.eye(3), -about))


def near(points: Array, seed: int, degrees: float = 3.0, metres: float = 0.002) -> Array:
    return moved(T_BONE_TRACKER, seed, degrees, metres, points.mean(axis=0))


def measured(n: int = 1000, soft: int = 0, seed: int = 0) -> Array:
    """Return noisy points, ``soft`` of them in one patch 2-5 mm off the bone; tracker frame."""
    points = touched_points(n, seed, 3e-4)
    _, gradient = bone_field().sample(points)
    there = np.argsort(np.linalg.norm(points - points[0], axis=1))[:soft]
    off = 0.002 + 0.003 * np.sin(40.0 * points[there, 1]) ** 2
    points[there] += off[:, None] * gradient[there]
    return rigid.transform(T_TRACKER_BONE, points)


def apart(a: Array, b: Array, points: Array) -> float:
    """Return the maximum distance between points placed by two poses, m."""
    return float(
        np.linalg.norm(rigid.transform(a, points) - rigid.transform(b, points), axis=1).max())


def test_converges_from_a_nearby_pose() -> None:
    for seed in range(3):
        points = measured(1000, 0, seed)
        solution = solve(points, bone_field(), near(points, seed), CONFIG)
        assert solution.converged
        # the bone is nearly round, so noise lets it slide a little
        assert apart(solution.T_bone_tracker, T_BONE_TRACKER, points) < 5e-4
        assert solution.estimates is not None
        assert solution.estimates.noise == pytest.approx(3e-4, rel=0.3)
        assert (solution.weights > 0.5).sum() > 950


@pytest.mark.parametrize(('soft', 'iterations', 'error'), [(0, 10, 2e-6), (150, 60, 2e-5)])
@given(seed=seeds)
@LAW
def test_warm_start_half_a_millimetre_off_converges_to_the_same_pose(
        soft: int, iterations: int, error: float, seed: int) -> None:
    """Each stops at a step of 1 um; with interference, steps shrink slowly."""
    points = measured(1000, soft, seed % 5)
    guess = near(points, seed)
    neighbours = nearest_neighbours(points, bone_field(), guess)
    cold = solve(points, bone_field(), guess, CONFIG, neighbours=neighbours)
    pose = moved(cold.T_bone_tracker, seed, 0.3, 5e-4, points.mean(axis=0))
    warm = refine(points, bone_field(), dataclasses.replace(cold, T_bone_tracker=pose), CONFIG,
                  neighbours)
    assert warm.converged and warm.iterations <= iterations
    assert apart(warm.T_bone_tracker, cold.T_bone_tracker, points) < error
    np.testing.assert_allclose(warm.weights, cold.weights, atol=0.02)
    np.testing.assert_allclose(warm.estimates, cold.estimates, rtol=0.02)
    assert warm.score == pytest.approx(cold.score, abs=0.1)


def test_warm_start_at_the_solution_takes_one_iteration() -> None:
    points = measured()
    guess = near(points, 1)
    neighbours = nearest_neighbours(points, bone_field(), guess)
    cold = solve(points, bone_field(), guess, CONFIG)
    warm = refine(points, bone_field(), cold, CONFIG, neighbours)
    assert warm.iterations == 1 and warm.converged
    np.testing.assert_allclose(warm.T_bone_tracker, cold.T_bone_tracker, atol=1e-14)


def test_adding_points_converges_to_the_solution_of_all_points() -> None:
    points = measured(1000, 100)
    guess = near(points, 2)
    near_by = Neighbourhood(points[:600], bone_field(), guess)
    first = solution = solve(points[:600], bone_field(), guess, CONFIG, neighbours=near_by.indices)
    for k in range(600, 1000, 50):
        near_by.add(points[k:k + 50])
        solution = refine(points[:k + 50], bone_field(), solution, CONFIG, near_by.indices)
    whole = solve(points, bone_field(), guess, CONFIG)
    again = refine(points, bone_field(), solution, CONFIG, near_by.indices, reuse_correction=False)
    assert apart(first.T_bone_tracker, whole.T_bone_tracker, points) > 3e-5
    assert apart(again.T_bone_tracker, whole.T_bone_tracker, points) < 2.0 * local_solver.TOLERANCE
    # the correction of fewer points is nearly the same
    assert apart(solution.T_bone_tracker, whole.T_bone_tracker, points) < 5e-5


def test_finds_neighbours_if_none_are_given() -> None:
    points = measured()
    cold = solve(points, bone_field(), near(points, 4), CONFIG)
    cold = dataclasses.replace(cold, T_bone_tracker=near(points, 5, 0.3, 5e-4))
    neighbours = nearest_neighbours(points, bone_field(), cold.T_bone_tracker)
    known, found = (refine(points, bone_field(), cold, CONFIG, n) for n in (neighbours, None))
    assert known.T_bone_tracker.tobytes() == found.T_bone_tracker.tobytes()


def test_refine_continues_with_the_published_method() -> None:
    points, config = measured(), SolverConfig(method='paper')
    first = solve(points, bone_field(), near(points, 6), config)
    assert first.estimates is None
    again = refine(points, bone_field(), first, config)
    assert again.T_bone_tracker.tobytes() == solve(points, bone_field(), first.T_bone_tracker,
                                                   config).T_bone_tracker.tobytes()


@pytest.mark.parametrize('limit', [3, 200])
def test_stops_at_the_maximum_number_of_iterations(limit: int) -> None:
    config = dataclasses.replace(CONFIG, max_iterations=limit)
    points = measured(1000, 150)
    solution = solve(points, bone_field(), near(points, 7), config)
    assert solution.converged == (limit == 200) and solution.iterations <= limit


@given(seeds)
@LAW
def test_is_invariant_to_the_order_of_the_points(seed: int) -> None:
    points = measured(600, 60, seed % 5)
    order = np.random.default_rng(seed).permutation(len(points))
    guess = near(points, seed)
    one, other = (solve(x, bone_field(), guess, CONFIG) for x in (points, points[order]))
    assert apart(one.T_bone_tracker, other.T_bone_tracker, points) < 1e-9
    np.testing.assert_allclose(other.weights, one.weights[order], atol=1e-6)


@given(seeds, st.sampled_from([1000.0, 1e-3, 4.0]))
@LAW
def test_is_invariant_to_the_unit_of_length(seed: int, factor: float) -> None:
    """Convert all lengths of bone, points, pose, estimates, settings and constants."""
    points, field = measured(600, 60, seed % 5), bone_field()
    cold = solve(points, field, near(points, seed), CONFIG)
    start = dataclasses.replace(cold, T_bone_tracker=near(points, seed, 0.3, 5e-4))
    assert start.estimates is not None
    nodes = field.arrays.nodes.copy()
    nodes[:, 0] *= np.float32(factor)
    scaled_field = dataclasses.replace(
        field, arrays=field.arrays._replace(origin=field.arrays.origin * factor,
                                            voxel=field.arrays.voxel * factor, nodes=nodes))
    pose = start.T_bone_tracker.copy()
    pose[:3, 3] *= factor
    correction = start.correction.copy()
    correction[:3, 3] *= factor
    scaled_start = dataclasses.replace(
        start, T_bone_tracker=pose, correction=correction,
        estimates=Estimates(factor * start.estimates.noise, factor * start.estimates.local_sd,
                            start.estimates.inlier_ratio,
                            factor * start.estimates.max_local_sd))
    metres = refine(points, field, start, CONFIG, reuse_correction=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local_solver, 'INTERFERENCE_RANGE', INTERFERENCE_RANGE * factor)
        patch.setattr(local_solver, 'TOLERANCE', local_solver.TOLERANCE * factor)
        other = refine(factor * points, scaled_field, scaled_start, CONFIG,
                       reuse_correction=False)
    T = other.T_bone_tracker.copy()
    T[:3, 3] /= factor
    assert other.iterations == metres.iterations
    assert apart(T, metres.T_bone_tracker, points) < 1e-9


def same_bits(a: Solution, b: Solution) -> bool:
    names = ('T_bone_tracker', 'weights', 'residuals', 'jacobian')
    return a.estimates == b.estimates and a.score == b.score and all(
        getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in names)


def test_is_deterministic_in_many_threads() -> None:
    points = measured(1000, 100)
    guess = near(points, 8)
    first = solve(points, bone_field(), guess, CONFIG)
    warm = refine(points, bone_field(), first, CONFIG)
    with ThreadPoolExecutor(4) as pool:
        for other in pool.map(lambda _: solve(points, bone_field(), guess, CONFIG), range(8)):
            assert same_bits(first, other)
        for other in pool.map(lambda _: refine(points, bone_field(), first, CONFIG), range(8)):
            assert same_bits(warm, other)


def test_does_not_modify_its_input() -> None:
    points = measured()
    cold = solve(points, bone_field(), near(points, 9), CONFIG)
    before = points.copy(), cold.T_bone_tracker.copy(), cold.weights.copy(), cold.estimates
    refine(points, bone_field(), cold, CONFIG)
    np.testing.assert_array_equal(points, before[0])
    np.testing.assert_array_equal(cold.T_bone_tracker, before[1])
    np.testing.assert_array_equal(cold.weights, before[2])
    assert cold.estimates == before[3]


def some_residuals(far: bool) -> tuple[Array, np.ndarray]:
    rng = np.random.default_rng(0)
    e = rng.normal(0.0, 0.002, 300)
    if far:
        e[rng.choice(300, 120, replace=False)] = rng.uniform(0.012, 0.1, 120)
        e[0] = np.nan
    return e, np.array([rng.permutation(300)[:8] for _ in range(300)])


@pytest.mark.parametrize('far', [False, True])
def test_local_means_exclude_far_points(far: bool) -> None:
    e, neighbours = some_residuals(far)
    mean = np.zeros(300)
    local_means(e, neighbours, INTERFERENCE_RANGE, np.zeros(600), mean)
    close = np.abs(e[neighbours]) < 2.0 * INTERFERENCE_RANGE
    expected = np.where(close, e[neighbours], 0.0).sum(axis=1) / np.maximum(close.sum(axis=1), 1)
    expected = np.where(close.any(axis=1), expected, e)
    np.testing.assert_allclose(mean, expected, rtol=1e-9, atol=1e-18)


def test_noise_is_the_median_deviation_from_the_local_mean() -> None:
    e, _ = some_residuals(False)
    mean = np.random.default_rng(1).normal(0.0, 0.005, 300)
    close = np.abs(mean) < INTERFERENCE_RANGE
    expected = np.median(np.abs(e - mean)[close]) / norm.ppf(0.75) / np.sqrt(15 / 16)

    def noise(mean: Array, floor: float) -> float:
        return float(_white_noise(e, mean, 16, INTERFERENCE_RANGE, floor, np.zeros(300)))
    assert noise(mean, 1e-9) == pytest.approx(expected, 1e-4)
    assert noise(mean, 1.0) == 1.0
    assert noise(mean + 1.0, 1e-5) == 1e-5      # no point is near the bone


def test_weights_and_likelihood_agree_with_the_mixture_density() -> None:
    rng = np.random.default_rng(2)
    mean, ratio, noise, local_sd = rng.normal(0.0, 3e-4, 500), 0.8, 3e-4, 1e-4
    e = mean + rng.normal(0.0, 4e-4, 500)
    on_bone = ratio * norm.pdf(mean, scale=local_sd)
    side = np.where(mean > 0.0, OUTSIDE_SHARE, 1.0 - OUTSIDE_SHARE)
    interference = (1.0 - ratio) * side / INTERFERENCE_RANGE
    excess = np.minimum(0.0, OUTLIER_EXCESS - 0.5 * ((e - mean) / noise) ** 2)
    odds = np.log(on_bone / interference) + excess
    weight = np.zeros(500)
    count, variance, likely = _expectation(e, mean, ratio, noise, local_sd,
                                            INTERFERENCE_RANGE, weight)
    assert (count, likely) == (pytest.approx(weight.sum()), (weight > 0.5).sum())
    assert variance == pytest.approx((weight * mean**2).sum() / weight.sum())
    np.testing.assert_allclose(weight, np.where(odds > -30.0, expit(odds), 0.0), rtol=1e-9)
    assert _log_likelihood(mean, 16, ratio, local_sd, INTERFERENCE_RANGE) == pytest.approx(
        np.log(on_bone + interference).sum() / 16, rel=1e-12)


def test_observed_information_is_the_derivative_of_the_weighted_mean() -> None:
    """Compare with d(w m)/dm of a local mean m; negative where a point becomes an outlier."""
    mean, local_sd, step = np.linspace(-6e-4, 6e-4, 201), 1e-4, 1e-9

    def weight(m: Array) -> Array:
        w = np.zeros(len(m))
        _expectation(m, m, 0.8, 3e-4, local_sd, INTERFERENCE_RANGE, w)
        return w
    slope = ((mean + step) * weight(mean + step) - (mean - step) * weight(mean - step)) / (2 * step)
    away = np.abs(mean) > 2 * step      # the odds jump at the surface
    curvature = np.zeros(len(mean))
    _observed_information(mean, weight(mean), local_sd, len(mean), np.zeros(0), curvature)
    np.testing.assert_allclose(curvature[away], slope[away], rtol=1e-3, atol=1e-5)
    assert curvature.min() < -0.2 and curvature.max() > 0.9
