# SPDX-License-Identifier: Apache-2.0
"""Regional model error: found where there is one, allowed for, and not found in noise."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points, with_model_error

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import assess_at
from gsdf_registration.solver import Solution, allow_for_model_error, solve
from gsdf_registration.solver.model_error import (
    FINE,
    _group,
    _matern,
    _restricted_likelihood,
    find_model_error,
)

CONFIG = SolverConfig()
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
SIGMA = 3e-4                    # m, noise
ERROR, LENGTH = 3e-4, 0.012     # m, model error (SD) and its correlation length


def measured(seed: int, error: float = ERROR, n: int = 800) -> Array:
    """
    Return noisy points (n, 3), tracker frame, of a bone whose model has an error (SD), m.

    Most of them lie close together, as points of strokes do.
    """
    points = np.concatenate([touched_points(3 * n // 4, seed, radius=0.02),
                             touched_points(n - 3 * n // 4, seed)])
    points = with_model_error(points, seed, error, LENGTH)
    noise = SIGMA * np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(rigid.transform(T_TRACKER_BONE, points + noise))


def solved(points: Array) -> Solution:
    return solve(points, bone_field(), T_BONE_TRACKER, CONFIG)


def error_of(solution: Solution, centroid: Array) -> Array:
    """Return the error of the pose, [rotation about ``centroid``, translation], bone frame."""
    motion = solution.T_bone_tracker @ T_TRACKER_BONE
    return np.concatenate([rigid.rotation_log(motion[:3, :3]),
                           rigid.transform(motion, centroid) - centroid])


class Trial(NamedTuple):
    """Errors over the bone (m, RMS) and NEES, without and with allowing for the model error."""

    without: float
    allowed: float
    nees_without: float
    nees_allowed: float


@cache
def trials() -> list[Trial]:
    surface = bone_field().surface_points[::10].astype(np.float64)
    found = []
    for seed in range(30):
        points = measured(seed)
        figures = []
        for solution in (solved(points), allow_for_model_error(solved(points), points)):
            confidence = assess_at(solution, points, bone_field(), CONFIG)
            assert confidence is not None
            e = error_of(solution, confidence.centroid)
            tre = rigid.displacement(solution.T_bone_tracker @ T_TRACKER_BONE, np.eye(4), surface)
            figures.append((float(np.sqrt((tre**2).mean())),
                            float(e @ np.linalg.solve(confidence.motion_covariance, e))))
        (without, nees_without), (allowed, nees_allowed) = figures
        found.append(Trial(without, allowed, nees_without, nees_allowed))
    return found


def test_finds_no_model_error_in_noise() -> None:
    solutions = [(solved(points), points) for points in (measured(seed, 0.0) for seed in range(30))]
    untouched = [allow_for_model_error(solution, points) is solution
                 for solution, points in solutions]
    assert sum(untouched) >= 28     # the threshold permits rare false alarms


def test_estimates_size_noise_and_correlation_length() -> None:
    errors = [allow_for_model_error(solved(points), points).model_error
              for points in (measured(seed) for seed in range(8))]
    assert all(error is not None for error in errors)
    assert np.median([error.sd for error in errors if error]) == pytest.approx(ERROR, rel=0.4)
    assert np.median([error.noise for error in errors if error]) == pytest.approx(SIGMA, rel=0.1)
    assert 0.5 * LENGTH < np.median([error.length for error in errors if error]) < 3.0 * LENGTH


def test_reduces_the_error_of_the_pose() -> None:
    without, allowed = (np.sqrt(np.mean(np.square(figure))) for figure in zip(
        *((trial.without, trial.allowed) for trial in trials())))
    assert allowed < 0.85 * without


def test_covariance_is_consistent_with_the_error_of_the_pose() -> None:
    without, allowed = (np.mean(figure) / 6.0 for figure in zip(
        *((trial.nees_without, trial.nees_allowed) for trial in trials())))
    assert without > 4.0        # correlated points taken as independent
    assert 0.6 < allowed < 2.0


@settings(deadline=None, max_examples=5)
@given(st.integers(0, 10**6))
def test_is_invariant_under_rigid_motion(seed: int) -> None:
    T = rigid.exp(np.random.default_rng(seed).uniform(-1.0, 1.0, 6))
    here = measured(4)
    there = rigid.transform(T, here)
    solution = allow_for_model_error(solved(here), here)
    moved = allow_for_model_error(
        solve(there, bone_field(), T_BONE_TRACKER @ rigid.inverse(T), CONFIG), there)
    assert solution.model_error is not None and moved.model_error is not None
    np.testing.assert_allclose(moved.T_bone_tracker @ T, solution.T_bone_tracker, atol=2e-6)
    assert moved.model_error.sd == pytest.approx(solution.model_error.sd, rel=1e-3)


def test_step_is_part_of_the_correction() -> None:
    points = measured(1)
    before = solved(points)
    after = allow_for_model_error(before, points)
    np.testing.assert_allclose(rigid.inverse(after.correction) @ after.T_bone_tracker,
                               rigid.inverse(before.correction) @ before.T_bone_tracker, atol=1e-12)
    distance = bone_field().sample(rigid.transform(after.T_bone_tracker, points))[0]
    # the bias that was removed from the residuals
    np.testing.assert_allclose(after.residuals, distance, atol=1e-4)


def test_information_agrees_with_the_full_covariance() -> None:
    """Compare with J^T V^-1 J, where V is the covariance of all residuals."""
    points = measured(2, 2.0 * ERROR, n=300)
    solution = solved(points)
    x = rigid.transform(solution.T_bone_tracker, points)
    e, J, w = solution.residuals, solution.jacobian, np.full(300, 0.9)
    precision = np.linspace(0.8, 1.2, 300)
    error = find_model_error(x, e, J, w, precision)
    cells = _group(x - e[:, None] * J[:, 3:], e, J, w, precision, *FINE)
    assert error is not None and cells is not None
    among = _matern(cells.distance, np.ones(len(cells.root)), error.length)
    among = among[np.ix_(cells.which, cells.which)]
    V = np.diag(error.noise**2 / (w * precision**2)) + error.sd**2 * among
    information = J.T @ np.linalg.solve(V, J)
    scale = np.sqrt(np.outer(np.diag(information), np.diag(information)))
    weight = w * precision**2
    assert (np.abs(((J.T * weight) @ J - error.information_loss) / error.noise**2 - information)
            < 1e-9 * scale).all()
    assert (np.abs((error.jacobian.T * weight) @ J / error.noise**2 - information)
            < 1e-9 * scale).all()
    # for generalized least squares, the covariance of J^T W e equals the information
    between = (error.jacobian.T * weight**2 / weight) @ error.jacobian + error.score_covariance
    assert (np.abs(between / error.noise**2 - information) < 1e-9 * scale).all()


def test_restricted_likelihood_is_the_density_of_the_residual_contrasts() -> None:
    """Compare with the density of A^T e, A orthogonal to J (Patterson and Thompson)."""
    rng = np.random.default_rng(0)
    J, e, v = rng.normal(size=(20, 6)), rng.normal(size=20), rng.uniform(0.5, 2.0, 20)
    A = np.linalg.svd(J, full_matrices=True)[0][:, 6:]
    S = A.T @ np.diag(v) @ A
    rest = A.T @ e
    # plus 30 points about the means of their cells, with the same variance
    variance = (rest @ np.linalg.solve(S, rest) + 40.0) / (14 + 30)
    expected = -0.5 * (np.linalg.slogdet(S)[1] + np.linalg.slogdet(J.T @ J)[1]
                       + 44 * np.log(variance))
    likelihood, noise = _restricted_likelihood(np.diag(v), np.vstack([J.T, e]), 40.0, 50.0)
    assert likelihood == pytest.approx(expected, rel=1e-12)
    assert noise == pytest.approx(np.sqrt(variance), rel=1e-12)


def test_few_points_and_the_published_method_are_unchanged() -> None:
    few = measured(0, n=60)
    solution = solved(few)
    assert allow_for_model_error(solution, few) is solution
    points = measured(0)
    published = solve(points, bone_field(), T_BONE_TRACKER, SolverConfig(method='paper'))
    assert allow_for_model_error(published, points) is published


def test_finds_no_model_error_on_a_plane() -> None:
    rng = np.random.default_rng(0)
    x = np.column_stack([rng.uniform(-0.03, 0.03, (300, 2)), np.zeros(300)])
    normal = np.array([0.0, 0.0, 1.0])
    J = np.concatenate([np.cross(x, normal), np.tile(normal, (300, 1))], axis=1)
    e = 1e-3 * np.sin(x[:, 0] / 0.01) + 1e-4 * rng.normal(size=300)
    assert find_model_error(x, e, J, np.ones(300), np.ones(300)) is None
