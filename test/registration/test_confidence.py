# SPDX-License-Identifier: Apache-2.0
"""The predicted covariance and TRE, compared with the errors of 200 registrations."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from smooth_bone import bone_field, touched_points, with_model_error

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import (
    Confidence,
    _excess,
    assess,
    assess_at,
    predicted_tre,
)
from gsdf_registration.solver import (
    Solution,
    allow_for_model_error,
    nearest_neighbours,
    solve,
)

TRIALS = 200
SIGMA = 5e-4
TARGETS = np.array([[0.0, 0.0, 0.06], [0.0, -0.04, 0.0], [-0.03, 0.0, 0.0], [0.2, 0.1, -0.3]])
METHODS = ('paper', 'mixture')


def confidence_at(points: Array, field: Field, guess: Array,
                  method: str = 'paper') -> tuple[Solution, Confidence]:
    """
    Solve from an initial guess (4, 4) T_bone_tracker; return the solution and its confidence.
    """
    config = SolverConfig(method=method)
    solution = solve(points, field, guess, config)
    confidence = assess_at(solution, points, field, 0.0)
    assert confidence is not None
    return solution, confidence


def pose_error(found: Array, truth: Array) -> Array:
    """
    Return the error x y z rx ry rz about the fixed axes of the tracker frame (REP-103).
    """
    return np.concatenate(
        [found[:3, 3] - truth[:3, 3],
         rigid.rotation_log(found[:3, :3] @ truth[:3, :3].T)])


@cache
def trials(method: str) -> dict[str, Any]:
    """Return the errors and predictions of many registrations at random poses."""
    rng = np.random.default_rng(0)
    bare = touched_points(300, 0)
    nees, tre, predicted = [], [], []
    for _ in range(TRIALS):
        T = rigid.exp(np.concatenate([rng.uniform(-1.8, 1.8, 3), rng.uniform(-1.0, 1.0, 3)]))
        seen = rigid.transform(T, bare) + SIGMA * rng.normal(size=bare.shape)
        solution, confidence = confidence_at(seen, bone_field(), rigid.inverse(T), method)
        found = rigid.inverse(solution.T_bone_tracker)
        error = pose_error(found, T)
        nees.append(error @ np.linalg.solve(confidence.pose_covariance(found), error))
        tre.append(
            np.linalg.norm(rigid.transform(found, TARGETS) - rigid.transform(T, TARGETS), axis=1))
        predicted.append(confidence.predicted_tre(TARGETS))
    return {'nees': np.array(nees), 'tre': np.array(tre), 'predicted': np.array(predicted)}


@pytest.mark.parametrize('method', METHODS)
def test_the_95_percent_ellipsoid_contains_the_truth_in_95_percent(method: str) -> None:
    share = float((trials(method)['nees'] <= chi2.ppf(0.95, 6)).mean())
    assert 0.90 <= share <= 0.98


@pytest.mark.parametrize('method', METHODS)
def test_the_covariance_is_neither_too_large_nor_too_small(method: str) -> None:
    # chi2(6) has the mean 6; that of 200 draws is within 10 % of it but once in a hundred times
    assert 0.8 < trials(method)['nees'].mean() / 6.0 < 1.25


@pytest.mark.parametrize('method', METHODS)
def test_the_predicted_tre_matches_the_measured_one(method: str) -> None:
    measured = np.sqrt((trials(method)['tre']**2).mean(axis=0))
    predicted = np.sqrt((trials(method)['predicted']**2).mean(axis=0))
    np.testing.assert_allclose(predicted, measured, rtol=0.15)


def test_a_tip_that_is_off_moves_the_bone_by_its_error() -> None:
    """All points are off in one direction, as by a tool that is held one way."""
    tip_error, rng, nees = 4e-4, np.random.default_rng(3), []
    for seed in range(60):
        shift = rng.normal(size=3)
        points = touched_points(300, seed, 1e-4) + tip_error * shift / np.linalg.norm(shift)
        solution = solve(points, bone_field(), np.eye(4), SolverConfig())
        confidence, without = (assess_at(solution, points, bone_field(), error)
                               for error in (tip_error, 0.0))
        assert confidence is not None and without is not None
        np.testing.assert_allclose(confidence.predicted_tre(TARGETS)**2,
                                   without.predicted_tre(TARGETS)**2 + tip_error**2)
        found = rigid.inverse(solution.T_bone_tracker)
        e = pose_error(found, np.eye(4))
        nees.append(e @ np.linalg.solve(confidence.pose_covariance(found), e))
    assert np.mean(np.array(nees) <= chi2.ppf(0.95, 6)) >= 0.93


def test_pose_covariance_matches_sampled_motions() -> None:
    """Sample motions of the bone frame and compare the covariance of the moved poses."""
    rng = np.random.default_rng(1)
    L = rng.normal(size=(6, 6)) * np.array([1e-3] * 3 + [1e-4] * 3)[:, None]
    centre = np.array([0.02, -0.05, 0.3])
    T = rigid.exp([0.7, -1.2, 0.4, 0.5, -0.3, -1.5])
    motions = rng.normal(size=(4000, 6)) @ L.T
    rows = []
    for xi_phi in motions:
        D = rigid.from_rt(np.eye(3), centre) @ rigid.exp(xi_phi) @ rigid.from_rt(np.eye(3), -centre)
        moved = T @ rigid.inverse(D)
        rows.append(pose_error(moved, T))
    drawn = np.cov(np.array(rows).T)
    claimed = Confidence(np.cov(motions.T), centre, SIGMA, 1.0).pose_covariance(T)
    scale = np.sqrt(np.diag(claimed))
    np.testing.assert_allclose(drawn / np.outer(scale, scale),
                               claimed / np.outer(scale, scale),
                               atol=0.01)


def test_the_confidence_does_not_depend_on_the_tracker_frame() -> None:
    bare = touched_points(300, 3, SIGMA)
    T = rigid.exp([1.0, -0.4, 2.0, 0.8, -0.5, -1.4])
    _, here = confidence_at(bare, bone_field(), np.eye(4))
    _, there = confidence_at(rigid.transform(T, bare), bone_field(), rigid.inverse(T))
    np.testing.assert_allclose(there.motion_covariance,
                               here.motion_covariance,
                               rtol=1e-5,
                               atol=1e-18)
    np.testing.assert_allclose(there.predicted_tre(TARGETS), here.predicted_tre(TARGETS), rtol=1e-6)
    # the covariance of the pose turns with the tracker
    turn = np.kron(np.eye(2), T[:3, :3])
    np.testing.assert_allclose(there.pose_covariance(T),
                               turn @ here.pose_covariance(np.eye(4)) @ turn.T,
                               rtol=1e-5,
                               atol=1e-12)


def test_four_times_the_points_halve_the_predicted_tre() -> None:
    few, many = (confidence_at(touched_points(n, 4, SIGMA), bone_field(),
                               np.eye(4))[1].predicted_tre(TARGETS) for n in (250, 1000))
    np.testing.assert_allclose(few / many, 2.0, rtol=0.15)


def test_doubtful_points_reduce_the_information_at_most_to_zero() -> None:
    solution, _ = confidence_at(touched_points(300, 3, SIGMA), bone_field(), np.eye(4), 'mixture')
    neighbours = np.zeros((300, 3), dtype=np.int64)

    def claimed(doubt: float) -> float:
        curvature = solution.curvature.copy()
        curvature[:60] = doubt
        doubted = dataclasses.replace(solution, curvature=curvature)
        found = assess(doubted, np.zeros((300, 3)), neighbours, 0.0)
        assert found is not None
        return float(np.trace(found.motion_covariance))
    without = claimed(0.0)
    assert claimed(1.0) < claimed(0.5) < without
    assert claimed(-0.5) == claimed(-100.0) == without


def test_points_on_a_plane_do_not_constrain_the_pose() -> None:
    points = touched_points(300, 0, SIGMA)
    solution, _ = confidence_at(points, bone_field(), np.eye(4))
    flat = solution.jacobian.copy()
    # rotation about x or y and translation along z change no distance
    flat[:, [0, 1, 5]] = 0.0
    assert assess(dataclasses.replace(solution, jacobian=flat), points,
                  nearest_neighbours(points, bone_field(), np.eye(4), 16), 0.0) is None


def test_the_predicted_tre_follows_from_the_pose_covariance() -> None:
    _, confidence = confidence_at(touched_points(300, 0, SIGMA), bone_field(), np.eye(4))
    surface = bone_field().surface_points.astype(np.float64)
    T_tracker_bone = rigid.exp([1.0, -0.5, 2.0, 0.3, -0.1, -1.5])
    covariance = confidence.pose_covariance(T_tracker_bone)
    np.testing.assert_allclose(predicted_tre(T_tracker_bone, covariance, surface),
                               confidence.predicted_tre(surface), rtol=1e-6)


@pytest.mark.parametrize('axes', [(1.0, 0.0, 0.0), (1.0, 0.4, 0.1), (1.0, 1.0, 0.3),
                                  (0.2, 0.2, 1.0), (1.0, 1.0, 1.0)])
def test_95_percent_of_the_errors_at_a_target_are_within_its_bound(
        axes: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(0)
    factor = np.vstack([1e-2 * np.eye(3), np.diag(axes)]) @ rng.normal(size=(3, 3)) * 1e-3
    confidence = Confidence(factor @ factor.T, np.array([0.1, 0.0, 0.0]), 1e-4, 1.0)
    targets = np.array([[0.1, 0.0, 0.0], [0.3, -0.2, 0.1]])
    motions = rng.normal(size=(200_000, 3)) @ factor.T
    bounds = confidence.p95(targets)
    for target, bound in zip(targets, bounds):
        errors = np.linalg.norm(np.cross(motions[:, :3], target - confidence.centroid)
                                + motions[:, 3:], axis=1)
        assert (errors < bound).mean() == pytest.approx(0.95, abs=0.004)


def test_the_bound_at_a_target_scales_with_the_unit_of_length() -> None:
    C = np.diag([1e-6, 2e-6, 3e-6, 1e-8, 2e-8, 3e-8])
    unit = np.diag([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
    target = np.array([[0.03, 0.02, -0.05]])
    metres, millimetres = (Confidence(covariance, np.zeros(3), 1e-4, 1.0).p95(places)
                           for covariance, places in ((C, target), (unit @ C @ unit, 1e3 * target)))
    assert millimetres == pytest.approx(1e3 * metres)


def test_without_uncertainty_the_bound_at_a_target_is_zero() -> None:
    assert Confidence(np.zeros((6, 6)), np.zeros(3), 0.0, 1.0).p95(TARGETS) == pytest.approx(0.0)


def test_an_error_of_the_model_never_makes_the_pose_more_certain() -> None:
    rng = np.random.default_rng(0)
    units = np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4])
    noise, total = (units[:, None] * a @ a.T * units for a in rng.normal(size=(2, 6, 6)))
    excess = _excess(total, noise)
    assert np.linalg.eigvalsh(excess / np.outer(units, units)).min() > -1e-12
    larger = noise + np.diag(units**2)
    np.testing.assert_allclose(_excess(larger, noise), np.diag(units**2), atol=1e-18)


def test_a_rest_among_strokes_does_not_add_the_error_of_the_model_to_the_noise() -> None:
    """One touch beside 800 points: the noise is that of the points about their neighbours."""
    points = with_model_error(touched_points(800, 1), 1, 5e-4, 0.012)
    points = points + 1.5e-4 * np.random.default_rng(1).normal(size=points.shape)
    sd = []
    for touches in (np.zeros(0), np.ones(1)):
        solution = solve(points, bone_field(), np.eye(4), SolverConfig(), touches=touches)
        solution = allow_for_model_error(solution, points, bone_field(), 2.5e-4)
        confidence = assess_at(solution, points, bone_field(), 0.0)
        assert confidence is not None
        sd.append(np.sqrt(np.diag(confidence.motion_covariance - confidence.model_covariance)))
    np.testing.assert_allclose(sd[1], sd[0], rtol=0.1)
