# SPDX-License-Identifier: Apache-2.0
"""Touches: formulas, convergence, interference, and touches together with strokes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit
from scipy.stats import norm
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver import refine, solve
from gsdf_registration.solver.mixture import INTERFERENCE_RANGE, OUTSIDE_SHARE
from gsdf_registration.solver.touches import (
    MAX_NOISE,
    touch_expectation,
    touch_likelihood,
    touch_noise,
    touch_variances,
)

CONFIG = SolverConfig()
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
SIGMA = 3e-4


def measured(n: int, soft: int = 0, seed: int = 0) -> Array:
    """Return ``n`` touches with noise, the first ``soft`` of them 2-5 mm off; tracker frame."""
    rng = np.random.default_rng(seed)
    points = touched_points(n, seed, SIGMA)
    normal = bone_field().sample(points[:soft])[1]
    points[:soft] += rng.uniform(0.002, 0.005, (soft, 1)) * normal
    return rigid.transform(T_TRACKER_BONE, points)


def near(points: Array, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    about = rigid.from_rt(np.eye(3), points.mean(axis=0) + 0.002 * way)
    turn = rigid.from_rt(rigid.rotation_exp(np.radians(3.0) * axis), np.zeros(3))
    return np.asarray(T_BONE_TRACKER @ about @ turn @ rigid.from_rt(np.eye(3),
                                                                    -points.mean(axis=0)))


def apart(a: Array, points: Array) -> float:
    moved = rigid.transform(a, points) - rigid.transform(T_BONE_TRACKER, points)
    return float(np.sqrt((moved**2).sum(axis=1).mean()))


def test_weights_and_likelihood_are_those_of_the_mixture() -> None:
    e = np.array([-0.004, -3e-4, 0.0, 3e-4, 9e-4, 0.005])
    variance, weight = np.empty(6), np.empty(6)
    relative = np.array([1.0, 0.5, 1.0, 2.0, 1.0, 1.0])
    touch_variances(relative, SIGMA, 1e-8, variance)
    np.testing.assert_allclose(variance, (SIGMA * relative)**2 + 1e-8)
    ratio = 0.8
    on = ratio * norm.pdf(e, 0.0, np.sqrt(variance))
    share = np.where(e > 0.0, OUTSIDE_SHARE, 1.0 - OUTSIDE_SHARE)
    off = (1.0 - ratio) * share / INTERFERENCE_RANGE
    found, likely = touch_expectation(e, variance, ratio, INTERFERENCE_RANGE, OUTSIDE_SHARE, weight)
    np.testing.assert_allclose(weight, expit(np.log(on / off)), atol=1e-12)
    assert found == pytest.approx(weight.sum()) and likely == (weight > 0.5).sum()
    assert touch_likelihood(e, variance, ratio, INTERFERENCE_RANGE, OUTSIDE_SHARE) == pytest.approx(
        np.log(on + off).sum())


def test_the_noise_is_not_biased_by_the_fitted_pose() -> None:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(300):
        J, e = rng.normal(size=(30, 6)), SIGMA * rng.normal(size=30)
        residual = e - J @ np.linalg.lstsq(J, e, rcond=None)[0]
        found.append(touch_noise(residual, np.ones(30), np.ones(30), 0.0)**2)
    assert np.sqrt(np.mean(found)) == pytest.approx(SIGMA, rel=0.03)
    assert touch_noise(np.full(30, 0.1), np.ones(30), np.ones(30), 0.0) == MAX_NOISE


@pytest.mark.parametrize('soft', [0, 10])
def test_converges_from_a_nearby_pose_and_leaves_out_soft_tissue(soft: int) -> None:
    for seed in range(3):
        points = measured(60, soft, seed)
        solution = solve(points, bone_field(), near(points, seed), CONFIG, touches=np.ones(60))
        assert solution.converged and solution.consistent
        # the bone is nearly round, so noise lets it slide a little
        assert apart(solution.T_bone_tracker, points[soft:]) < 1.5e-3
        assert solution.estimates is not None
        assert solution.estimates.noise == pytest.approx(SIGMA, rel=0.35)
        assert (solution.weights[:soft] < 0.1).all()
        assert (solution.weights[soft:] > 0.5).mean() > 0.9


def test_a_warm_solve_gives_the_same_pose() -> None:
    points = measured(60, 6)
    cold = solve(points, bone_field(), near(points, 1), CONFIG, touches=np.ones(60))
    warm = refine(points, bone_field(), cold, CONFIG)
    assert warm.iterations == 1
    np.testing.assert_allclose(warm.T_bone_tracker, cold.T_bone_tracker, atol=1e-12)


def test_a_noisy_touch_weighs_less() -> None:
    points, relative = measured(60), np.ones(60)
    relative[:5] = 4.0
    solution = solve(points, bone_field(), near(points, 0), CONFIG, touches=relative)
    np.testing.assert_allclose(solution.precision[:5], 0.25, rtol=0.05)
    np.testing.assert_allclose(solution.precision[5:], 1.0, rtol=0.05)


def test_touches_far_from_the_strokes_count() -> None:
    points = measured(600, 0, 2)
    x = rigid.transform(T_BONE_TRACKER, points)
    order = np.argsort(np.linalg.norm(x - x[0], axis=1))
    strokes, far = points[order[:400]], points[order[-12:]]
    together = np.concatenate([strokes, far])
    guess = near(points, 3)
    alone = solve(strokes, bone_field(), guess, CONFIG)
    both = solve(together, bone_field(), guess, CONFIG, touches=np.full(12, 0.5))
    assert len(both.weights) == 412 and (both.weights[400:] > 0.5).sum() >= 11
    np.testing.assert_allclose(both.precision[400:], 2.0, rtol=0.1)
    # the residuals of touches that are left out are larger than those of touches that are used
    e = bone_field().sample(rigid.transform(alone.T_bone_tracker, far))[0]
    assert rigid.rms(both.residuals[400:]) < rigid.rms(e)


def test_a_touch_beside_the_bone_does_not_pull_the_strokes() -> None:
    strokes = measured(600, 0, 4)
    normal = T_TRACKER_BONE[:3, :3] @ bone_field().sample(
        rigid.transform(T_BONE_TRACKER, strokes[:1]))[1][0]
    beside = strokes[:1] + 0.0035 * normal
    guess = near(strokes, 3)
    alone = solve(strokes, bone_field(), guess, CONFIG)
    both = solve(np.concatenate([strokes, beside]), bone_field(), guess, CONFIG,
                 touches=np.array([0.5]))
    assert both.weights[-1] < 1e-3
    np.testing.assert_allclose(both.T_bone_tracker, alone.T_bone_tracker, atol=2e-6)
