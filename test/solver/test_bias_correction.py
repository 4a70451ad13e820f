# SPDX-License-Identifier: Apache-2.0
"""Bias correction on a curved bone, and weights for anisotropic noise."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import (
    T_TRACKER_BONE,
    ball_mesh,
    bone_field,
    field_of,
    touched_points,
    with_model_error,
)

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver import Solution, solve
from gsdf_registration.solver.bias_correction import bias_correction
from gsdf_registration.solver.mixture import INTERFERENCE_RANGE

CONFIG = SolverConfig()
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)


def solved(sigma: Array | float, seed: int = 0, n: int = 1000) -> tuple[Solution, Array]:
    """Return a solution and its points, with noise ``sigma``, m, along each axis of the tracker."""
    noise = sigma * np.random.default_rng(seed).normal(size=(n, 3))
    points = rigid.transform(T_TRACKER_BONE, touched_points(n, seed)) + noise
    return solve(points, bone_field(), T_BONE_TRACKER, CONFIG), points


def uncorrected(solution: Solution) -> Array:
    """Return T_bone_tracker before the correction."""
    return np.asarray(rigid.inverse(solution.correction) @ solution.T_bone_tracker)


def test_residuals_have_the_expected_bias_removed() -> None:
    """Compare with the mean distance of 4000 noisy points around the nearest surface point."""
    solution, points = solved(1e-3)
    assert solution.estimates is not None
    x = rigid.transform(solution.T_bone_tracker, points)
    distance, gradient = bone_field().sample(x)
    for k in range(0, 1000, 100):
        draws = np.random.default_rng(k).normal(size=(2000, 3)) * solution.estimates.noise
        near = x[k] - distance[k] * gradient[k] + np.concatenate([draws, -draws])
        expected = bone_field().sample(near)[0].mean()
        assert distance[k] - solution.residuals[k] == pytest.approx(expected, abs=1e-5)


def test_removes_the_outward_bias_of_the_pose_on_a_curved_bone() -> None:
    """Mean over 40 registrations of a head of 12 mm radius, a cap of it touched, noise 0.8 mm."""
    mesh = ball_mesh(np.array([0.012, 0.013, 0.014]))
    field = field_of(mesh)
    before, after = np.zeros(3), np.zeros(3)
    for seed in range(40):
        solution = solve(touched_points(600, seed, 8e-4, 0.014, mesh), field, np.eye(4), CONFIG)
        before += uncorrected(solution)[:3, 3] / 40.0
        after += solution.T_bone_tracker[:3, 3] / 40.0
    # variance over radius is 53 um; the bias points to the side touched, +x
    assert before[0] < -4e-5
    assert abs(after[0]) < 0.4 * abs(before[0])


def test_precision_is_the_inverse_of_the_noise_along_the_normal() -> None:
    sigma = np.array([2e-4, 2e-4, 8e-4])
    solution, points = solved(sigma)
    _, normal = bone_field().sample(rigid.transform(solution.T_bone_tracker, points))
    along = np.sqrt((normal @ solution.T_bone_tracker[:3, :3])**2 @ sigma**2)
    relative = solution.precision * along
    assert along.std() / along.mean() > 0.3
    assert relative.std() / relative.mean() < 0.15
    assert solution.precision.max() > 2.0 * solution.precision.min()


def test_isotropic_noise_gives_nearly_equal_precision() -> None:
    solution, _ = solved(5e-4)
    assert np.abs(solution.precision - 1.0).max() < 0.15


def test_an_error_of_the_model_is_not_taken_for_anisotropic_noise() -> None:
    for seed in range(6):
        points = with_model_error(touched_points(1000, seed), seed, 5e-4, 0.012)
        noise = 1.5e-4 * np.random.default_rng(seed).normal(size=points.shape)
        points = rigid.transform(T_TRACKER_BONE, points + noise)
        solution = solve(points, bone_field(), T_BONE_TRACKER, CONFIG)
        assert np.abs(solution.precision - 1.0).max() < 0.25


def test_anisotropic_weights_reduce_the_error() -> None:
    sigma = np.array([2e-4, 2e-4, 8e-4])
    error = np.zeros(2)
    for seed in range(30):
        solution, points = solved(sigma, seed)
        for i, T in enumerate((uncorrected(solution), solution.T_bone_tracker)):
            error[i] += ((rigid.transform(T @ T_TRACKER_BONE, bone_field().surface_points)
                        - bone_field().surface_points)**2).sum(axis=1).mean()
    assert error[1] < 0.92 * error[0]


def test_takes_no_step_on_a_plane() -> None:
    n = 50
    points = np.random.default_rng(0).uniform(-0.01, 0.01, (n, 3))
    R, t = np.eye(3), np.zeros(3)
    J = np.zeros((n, 6))
    J[:, 5] = 1.0
    # with weight 0, the rows of J are left as they are
    assert not bias_correction(bone_field().arrays, points, R, t, np.zeros(n), 1e-4, np.ones(n), J,
                         np.ones(n), np.arange(n)[:, None], INTERFERENCE_RANGE)
    assert (np.eye(3) == R).all() and (t == 0.0).all()
