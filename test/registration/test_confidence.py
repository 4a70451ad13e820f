# SPDX-License-Identifier: Apache-2.0
"""What is claimed of a pose, against what happens in 200 registrations, anywhere in space."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from smooth_bone import ball_mesh, bone_field, field_of, touched

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence, assess, assess_at, predicted_tre
from gsdf_registration.solver import Solution, nearest_neighbours, solve

TRIALS = 200
SIGMA = 5e-4
TARGETS = np.array([[0.0, 0.0, 0.06], [0.0, -0.04, 0.0], [-0.03, 0.0, 0.0], [0.2, 0.1, -0.3]])
METHODS = ('paper', 'mixture')


def confidence_at(points: Array, field: Field, guess: Array,
                  method: str = 'paper') -> tuple[Solution, Confidence]:
    """
    Solve from a first guess (4, 4) T_bone_tracker; return the solution and what is claimed of it.
    """
    config = SolverConfig(method=method)
    solution = solve(points, field, guess, config)
    confidence = assess_at(solution, points, field, config)
    assert confidence is not None
    return solution, confidence


def pose_error(found: Array, truth: Array) -> Array:
    """
    Return x y z, then the rotation about the fixed axes of the tracker frame: the order of REP-103.
    """
    return np.concatenate(
        [found[:3, 3] - truth[:3, 3],
         rigid.rotation_log(found[:3, :3] @ truth[:3, :3].T)])


@cache
def trials(method: str) -> dict[str, Any]:
    """Return errors and claims of many registrations, each at a pose of its own, turned anyhow."""
    rng = np.random.default_rng(0)
    bare = touched(300, 0)
    nees, tre, claimed = [], [], []
    for _ in range(TRIALS):
        T = rigid.exp(np.concatenate([rng.uniform(-1.8, 1.8, 3), rng.uniform(-1.0, 1.0, 3)]))
        seen = rigid.transform(T, bare) + SIGMA * rng.normal(size=bare.shape)
        solution, confidence = confidence_at(seen, bone_field(), rigid.inverse(T), method)
        found = rigid.inverse(solution.T_bone_tracker)
        error = pose_error(found, T)
        nees.append(error @ np.linalg.solve(confidence.pose_covariance(found), error))
        tre.append(
            np.linalg.norm(rigid.transform(found, TARGETS) - rigid.transform(T, TARGETS), axis=1))
        claimed.append(confidence.predicted_tre(TARGETS))
    return {'nees': np.array(nees), 'tre': np.array(tre), 'claimed': np.array(claimed)}


@pytest.mark.parametrize('method', METHODS)
def test_the_95_percent_ellipsoid_holds_the_truth_that_often(method: str) -> None:
    share = float((trials(method)['nees'] <= chi2.ppf(0.95, 6)).mean())
    assert 0.90 <= share <= 0.98


@pytest.mark.parametrize('method', METHODS)
def test_the_covariance_is_neither_too_large_nor_too_small(method: str) -> None:
    # chi2(6) has the mean 6; that of 200 draws is within 10 % of it but once in a hundred times
    assert 0.8 < trials(method)['nees'].mean() / 6.0 < 1.25


@pytest.mark.parametrize('method', METHODS)
def test_predicted_tre_is_what_comes_out(method: str) -> None:
    measured = np.sqrt((trials(method)['tre']**2).mean(axis=0))
    predicted = np.sqrt((trials(method)['claimed']**2).mean(axis=0))
    np.testing.assert_allclose(predicted, measured, rtol=0.15)


def test_pose_covariance_is_that_of_the_pose_under_small_motions() -> None:
    """Draw motions of the bone frame, move the pose by them, take the covariance of the result."""
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


def test_the_claims_do_not_depend_on_where_the_tracker_stands() -> None:
    bare = touched(300, 3, SIGMA)
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
    few, many = (confidence_at(touched(n, 4, SIGMA), bone_field(),
                               np.eye(4))[1].predicted_tre(TARGETS) for n in (250, 1000))
    np.testing.assert_allclose(few / many, 2.0, rtol=0.15)


def test_the_weakest_direction_of_a_turned_shape_is_its_axis() -> None:
    spindle = ball_mesh(np.array([0.03, 0.031, 0.08]))
    field = field_of(spindle)
    points = touched(400, 0, 1e-4, radius=1.0, mesh=spindle)
    _, confidence = confidence_at(points, field, np.eye(4))
    weakest = confidence.weakest_direction(field.surface_points.astype(np.float64), {})
    assert abs(weakest.axis[2]) > 0.99
    assert np.linalg.norm(np.cross(weakest.point, [0.0, 0.0, 1.0])) < 2e-3
    assert abs(weakest.pitch_m_per_rad) < 1e-3
    assert 'rotation' in weakest.sentence and "the bone's long axis" in weakest.sentence


def test_the_weakest_direction_of_a_prism_is_along_it() -> None:
    """Points on the sides of a rod say nothing of where along it they are."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (500, 3)) * [0.02, 0.03, 0.05]
    normals = np.zeros((500, 3))
    normals[:250, 0], normals[250:, 1] = 1.0, 1.0
    normals[:5] = [0.0, 0.0, 1.0]                   # hardly anything of its end
    J = np.hstack([np.cross(points, normals), normals])
    confidence = Confidence(1e-8 * np.linalg.inv(J.T @ J), np.zeros(3), 1e-4, 1.0)
    weakest = confidence.weakest_direction(points, {'end': np.array([0.0, 0.0, 0.05])})
    assert abs(weakest.axis[2]) > 0.99 and 'sliding' in weakest.sentence
    assert weakest.translation_sigma_m == pytest.approx(1e-4 / np.sqrt(5), rel=0.1)


def test_names_of_the_bone_are_used_in_the_sentence() -> None:
    _, confidence = confidence_at(touched(300, 0, SIGMA), bone_field(), np.eye(4))
    surface = bone_field().surface_points.astype(np.float64)
    bare = confidence.weakest_direction(surface, {})
    named = confidence.weakest_direction(surface, {'far': bare.point + 0.1, 'knob': bare.point})
    assert 'knob' in named.sentence and 'far' not in named.sentence and 'mm' in bare.sentence


def test_points_of_doubt_take_away_but_no_more_than_there_is() -> None:
    solution, sure = confidence_at(touched(300, 3, SIGMA), bone_field(), np.eye(4), 'mixture')
    around = np.zeros((300, 3), dtype=np.int64)

    def claimed(doubt: float) -> float:
        curvature = solution.curvature.copy()
        curvature[:60] = doubt
        doubted = dataclasses.replace(solution, curvature=curvature)
        found = assess(doubted, np.zeros((300, 3)), around)
        assert found is not None
        return float(np.trace(found.motion_covariance))
    without = claimed(0.0)
    assert claimed(1.0) < without < claimed(-0.5)
    assert claimed(-100.0) == without


def test_points_in_one_plane_claim_nothing() -> None:
    points = touched(300, 0, SIGMA)
    solution, _ = confidence_at(points, bone_field(), np.eye(4))
    flat = solution.jacobian.copy()
    flat[:, [0, 1, 5]] = 0.0        # what turns about x or y or goes along z changes no distance
    assert assess(dataclasses.replace(solution, jacobian=flat), points,
                  nearest_neighbours(points, bone_field(), np.eye(4), 16)) is None


def test_the_error_over_the_bone_follows_from_the_covariance_of_the_pose() -> None:
    _, confidence = confidence_at(touched(300, 0, SIGMA), bone_field(), np.eye(4))
    surface = bone_field().surface_points.astype(np.float64)
    T_tracker_bone = rigid.exp([1.0, -0.5, 2.0, 0.3, -0.1, -1.5])
    covariance = confidence.pose_covariance(T_tracker_bone)
    np.testing.assert_allclose(predicted_tre(T_tracker_bone, covariance, surface),
                               confidence.predicted_tre(surface), rtol=1e-6)
