# SPDX-License-Identifier: Apache-2.0
"""Model error: estimated where there is one, allowed for, and small in noise."""

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
    EXACT,
    FINE,
    LENGTHS,
    PRIOR,
    SIZES,
    STATED_EXACT,
    STATED_PRIOR,
    Allowance,
    ErrorVariances,
    _group,
    _restricted_likelihood,
    _shrunk,
    error_variances,
)
from gsdf_registration.solver.process_matrices import add_matern, factor, gram, tridiagonalize

CONFIG = SolverConfig()
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
SIGMA = 3e-4                    # m, noise
ERROR, LENGTH = 3e-4, 0.012     # m, model error (SD) and its correlation length
EXPECTED = 2.5e-4               # m, expected model error


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


def allowed_for(solution: Solution, points: Array, expected: float = EXPECTED) -> Solution:
    return allow_for_model_error(solution, points, bone_field(), expected)


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
    for seed in range(60):
        points = measured(seed)
        figures = []
        for solution in (solved(points), allowed_for(solved(points), points)):
            confidence = assess_at(solution, points, bone_field(), 0.0)
            assert confidence is not None
            e = error_of(solution, confidence.centroid)
            tre = rigid.displacement(solution.T_bone_tracker @ T_TRACKER_BONE, np.eye(4), surface)
            figures.append((float(np.sqrt((tre**2).mean())),
                            float(e @ np.linalg.solve(confidence.motion_covariance, e))))
        (without, nees_without), (allowed, nees_allowed) = figures
        found.append(Trial(without, allowed, nees_without, nees_allowed))
    return found


def test_finds_no_model_error_in_noise() -> None:
    """Nearly always none is reported, and the stated error of the pose hardly grows."""
    reported, growth = [], []
    for seed in range(30):
        points = measured(seed, 0.0)
        before = solved(points)
        after = allowed_for(before, points)
        assert after.model_error is not None
        reported.append(after.model_error.sd > 0.0)
        stated = [assess_at(solution, points, bone_field(), 0.0) for solution in (before, after)]
        assert stated[0] is not None and stated[1] is not None
        growth.append(np.trace(stated[1].motion_covariance[3:, 3:])
                      / np.trace(stated[0].motion_covariance[3:, 3:]))
    assert sum(reported) <= 2
    assert np.median(np.sqrt(growth)) < 1.5


def test_estimates_size_and_noise() -> None:
    errors = [allowed_for(solved(points), points).model_error
              for points in (measured(seed) for seed in range(8))]
    assert np.median([error.sd for error in errors if error]) == pytest.approx(ERROR, rel=0.4)
    assert np.median([error.noise for error in errors if error]) == pytest.approx(SIGMA, rel=0.1)


def test_the_stated_error_of_the_offset_is_its_mean_square() -> None:
    rng, variance = np.random.default_rng(0), 1e-8
    offsets = EXPECTED * rng.choice(SIZES, 20_000, p=STATED_PRIOR) * rng.normal(size=20_000)
    found, stated = zip(*(_shrunk(value, variance, EXPECTED) for value in
                          offsets + np.sqrt(variance) * rng.normal(size=len(offsets))))
    squared = (np.array(found) - offsets)**2
    assert squared.mean() == pytest.approx(np.mean(stated), rel=0.05)
    # and of small measured offsets, which are mostly noise, as of large ones
    small = np.array(stated) < np.median(stated)
    assert squared[small].mean() == pytest.approx(np.array(stated)[small].mean(), rel=0.1)


@pytest.mark.parametrize('offset', [-4e-4, 4e-4])
def test_an_offset_of_the_whole_bone_does_not_move_the_pose(offset: float) -> None:
    touched = touched_points(800, 0)
    touched = touched + offset * bone_field().sample(touched)[1]
    noise = 1e-4 * np.random.default_rng(0).normal(size=touched.shape)
    points = rigid.transform(T_TRACKER_BONE, touched + noise)
    before = solved(points)
    after = allowed_for(before, points)
    assert after.model_error is not None
    assert after.model_error.offset == pytest.approx(offset, abs=5e-5)
    confidence = assess_at(after, points, bone_field(), 0.0)
    assert confidence is not None
    with_offset, without = (np.linalg.norm(error_of(solution, confidence.centroid)[3:])
                            for solution in (after, before))
    assert with_offset < 0.5 * without
    error = error_of(after, confidence.centroid)
    assert error @ np.linalg.solve(confidence.motion_covariance, error) < 20.0


def test_reduces_the_error_of_the_pose() -> None:
    without, allowed = (np.sqrt(np.mean(np.square(figure))) for figure in zip(
        *((trial.without, trial.allowed) for trial in trials())))
    assert allowed < 0.85 * without


def test_covariance_is_consistent_with_the_error_of_the_pose() -> None:
    without, allowed = (np.mean(figure) / 6.0 for figure in zip(
        *((trial.nees_without, trial.nees_allowed) for trial in trials())))
    assert without > 4.0        # correlated points taken as independent
    assert 0.4 < allowed < 1.4


@settings(deadline=None, max_examples=5)
@given(st.integers(0, 10**6))
def test_is_invariant_under_rigid_motion(seed: int) -> None:
    T = rigid.exp(np.random.default_rng(seed).uniform(-1.0, 1.0, 6))
    here = measured(4)
    there = rigid.transform(T, here)
    solution = allowed_for(solved(here), here)
    moved = allowed_for(solve(there, bone_field(), T_BONE_TRACKER @ rigid.inverse(T), CONFIG),
                        there)
    assert solution.model_error is not None and moved.model_error is not None
    np.testing.assert_allclose(moved.T_bone_tracker @ T, solution.T_bone_tracker, atol=2e-6)
    assert moved.model_error.sd == pytest.approx(solution.model_error.sd, rel=1e-3)


def test_step_is_part_of_the_correction() -> None:
    points = measured(1)
    before = solved(points)
    after = allowed_for(before, points)
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
    variances = (2.0 * ERROR)**2 * np.array([0.0, 0.3, 0.5, 0.2, 0.0])
    error = Allowance(ErrorVariances(EXPECTED, variances, variances, 1.0), x, e, J, w, precision,
                      SIGMA).error(e, J)
    cells = _group(x, e, J, w, precision, *FINE)
    assert cells is not None
    among = np.zeros(cells.distance.shape)
    for length, variance in zip(LENGTHS, variances):
        add_matern(cells.distance, np.ones(len(among)), length, variance, among)
    V = np.diag(error.noise**2 / (w * precision**2)) + among[np.ix_(cells.which, cells.which)]
    information = J.T @ np.linalg.solve(V, J)
    scale = np.sqrt(np.outer(np.diag(information), np.diag(information)))
    weight = w * precision**2
    assert (np.abs(((J.T * weight) @ J - error.information_loss) / error.noise**2 - information)
            < 1e-9 * scale).all()
    assert (np.abs((error.jacobian.T * weight) @ J / error.noise**2 - information)
            < 1e-9 * scale).all()
    # for generalized least squares, the covariance of J^T W e equals the information
    between = (error.jacobian.T * weight) @ error.jacobian + error.score_covariance
    assert (np.abs(between / error.noise**2 - information) < 1e-9 * scale).all()
    # what is stated may assume a larger error than the pose
    larger = Allowance(ErrorVariances(EXPECTED, variances, 2.0 * variances, 1.0), x, e, J, w,
                       precision, SIGMA).error(e, J)
    np.testing.assert_array_equal(larger.step, error.step)
    np.testing.assert_allclose(larger.score_covariance, 2.0 * error.score_covariance)


def test_the_likelihood_is_the_density_of_the_residual_contrasts() -> None:
    """Compare with the density of A^T e, A orthogonal to J (Patterson, Thompson)."""
    rng = np.random.default_rng(0)
    J, e, root = rng.normal(size=(30, 6)), rng.normal(size=30), rng.uniform(1.0, 2.0, 30)
    x = rng.uniform(0.0, 0.03, (30, 3))
    distance = np.linalg.norm(x[:, None] - x, axis=2)
    A = np.linalg.svd(J, full_matrices=True)[0][:, 6:]
    squares = SIZES**2
    expected = np.empty((len(LENGTHS), len(SIZES), len(SIZES)))
    for i, k, t in np.ndindex(expected.shape):
        V = np.eye(30) + squares[t] * np.outer(root, root)      # noise and offset
        add_matern(distance, root, LENGTHS[i], squares[k], V)
        S, rest = A.T @ V @ A, A.T @ e
        # plus 40 points about the means of their cells, with the same noise
        variance = (rest @ np.linalg.solve(S, rest) + 50.0) / (24 + 40)
        expected[i, k, t] = -0.5 * np.linalg.slogdet(S)[1] - 32.0 * np.log(variance)
    found = np.empty_like(expected)
    rows = np.concatenate([J.T, root[None], e[None]])
    _restricted_likelihood(distance, root, rows, 50.0, 70.0, squares, LENGTHS, found)
    np.testing.assert_allclose(found - found[0, 0, 0], expected - expected[0, 0, 0], atol=1e-9)


def test_the_tridiagonal_form_gives_the_same_products_as_the_full_matrix() -> None:
    rng = np.random.default_rng(1)
    S, rows = rng.normal(size=(12, 12)), rng.normal(size=(3, 12))
    S = S @ S.T
    S[0, 1:] = S[1:, 0] = 0.0       # nothing to reflect in the first column
    diagonal, beside, turned, G = np.empty(12), np.empty(12), rows.copy(), np.empty((3, 3))
    V = np.eye(12) + 0.5 * S
    tridiagonalize(S.copy(), turned, diagonal, beside)
    log_det = gram(diagonal, beside, 0.5, turned, G)
    np.testing.assert_allclose(G, rows @ np.linalg.solve(V, rows.T), rtol=1e-10)
    assert log_det == pytest.approx(np.linalg.slogdet(V)[1])
    assert factor(V.copy()) == pytest.approx(log_det)


@pytest.mark.parametrize('prior, exact', [(PRIOR, EXACT), (STATED_PRIOR, STATED_EXACT)])
def test_the_prior_probabilities_add_up(prior: Array, exact: float) -> None:
    assert prior.sum() == pytest.approx(1.0) and prior[0] == exact and (prior > 0.0).all()


def test_few_points_have_the_expected_error_but_none_above_their_residuals() -> None:
    few = measured(0, n=60)
    for expected in (EXPECTED, 2.0 * EXPECTED):
        assert allowed_for(solved(few), few, expected).model_error is not None
        large, small = (error_variances(
            few, np.full(60, share * expected), np.zeros((60, 6)), np.ones(60), np.ones(60),
            expected) for share in (6.0, 0.3))
        assert large.found == pytest.approx(1.0 - EXACT)
        for variances, prior in ((large.local, PRIOR), (large.stated, STATED_PRIOR)):
            assert np.sqrt(variances.sum()) == pytest.approx(expected * np.sqrt(prior @ SIZES**2))
        assert np.sqrt(small.local.sum()) < 0.32 * expected and small.found < 1.0 - EXACT


def test_an_exact_model_and_the_published_method_are_unchanged() -> None:
    points = measured(0)
    solution = solved(points)
    assert allowed_for(solution, points, 0.0) is solution
    published = solve(points, bone_field(), T_BONE_TRACKER, SolverConfig(method='paper'))
    assert allowed_for(published, points) is published


def test_points_of_a_plane_are_rejected() -> None:
    rng = np.random.default_rng(0)
    x = np.column_stack([rng.uniform(-0.03, 0.03, (300, 2)), np.zeros(300)])
    normal = np.array([0.0, 0.0, 1.0])
    J = np.concatenate([np.cross(x, normal), np.tile(normal, (300, 1))], axis=1)
    e = 1e-3 * np.sin(x[:, 0] / 0.01) + 1e-4 * rng.normal(size=300)
    rows = x, e, J, np.ones(300), np.ones(300)
    with pytest.raises(np.linalg.LinAlgError):
        Allowance(error_variances(*rows, EXPECTED), *rows, SIGMA).error(e, J)
