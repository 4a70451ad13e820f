# SPDX-License-Identifier: Apache-2.0
"""A pose updated point by point is as accurate as one solved from all points at once."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points, with_model_error

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.rigid import Array, exp, inverse, transform
from gsdf_registration.live.warm_pose import NEIGHBOURHOOD_TOLERANCE, WarmPose
from gsdf_registration.registration.confidence import assess_at
from gsdf_registration.solver import solve

CONFIG = Config.from_flat({'live.max_points': 2000})
EXACT = CONFIG.replaced({'model.surface_error': 0.0})
NEAR = exp([0.01, -0.01, 0.02, 0.0005, -0.0005, 0.001]) @ inverse(T_TRACKER_BONE)


@pytest.fixture(scope='module')
def points() -> Array:
    """Return points in the order of a probe, each near the one before."""
    seen = transform(T_TRACKER_BONE, touched_points(1200, 0, 2e-4))
    return seen[np.lexsort((seen[:, 1], np.round(seen[:, 0] / 0.002)))]


def warm(points: Array, config: Config = CONFIG, guess: Array = NEAR) -> WarmPose:
    solution = solve(points, bone_field(), guess, config.solver)
    pose = WarmPose(points, bone_field(), solution, config)
    pose.confidence = assess_at(pose.solution, points, bone_field(), 0.0)
    return pose


def apart(a: Array, b: Array, points: Array) -> float:
    """Return the distance of points between two poses, m (RMS)."""
    return float(np.sqrt(((transform(a, points) - transform(b, points))**2).sum(axis=1).mean()))


def test_points_added_one_by_one_give_the_pose_of_all_at_once(points: Array) -> None:
    pose, whole = warm(points[::2], EXACT), warm(points, EXACT)
    for point in points[1::2]:
        pose.add(point[None])
    assert len(pose.points) > 0.9 * len(points)     # the others are isolated
    found, wanted = pose.solution.T_bone_tracker, whole.solution.T_bone_tracker
    assert apart(found, wanted, points) < 5e-5
    assert apart(found, inverse(T_TRACKER_BONE), points) < 2e-4
    assert pose.covariance is not None and whole.covariance is not None
    np.testing.assert_allclose(np.diag(pose.covariance), np.diag(whole.covariance), rtol=0.25)


def test_covariance_decreases_as_points_are_added(points: Array) -> None:
    pose = warm(points[:800])
    before = pose.covariance
    pose.add(points[800:])
    assert before is not None and pose.covariance is not None
    assert (np.linalg.eigvalsh(before - pose.covariance) > 0.0).any()
    assert np.trace(pose.covariance) < np.trace(before)


def test_keeps_the_correction_for_model_error_between_assessments() -> None:
    seen = with_model_error(touched_points(1000, 0, 2e-4), 0, 4e-4, 0.012)
    points = np.random.default_rng(0).permutation(transform(T_TRACKER_BONE, seen))
    pose = warm(points[:950])
    plain = solve(points[:950], bone_field(), NEAR, CONFIG.solver).T_bone_tracker
    before = pose.confidence
    assert pose.solution.model_error is not None and before is not None
    stepped = apart(pose.solution.T_bone_tracker, plain, points)
    pose.add(points[950:])
    assert apart(pose.solution.T_bone_tracker, plain, points) > 0.7 * stepped > 5e-5
    after = pose.confidence
    assert after is not None and after.model_sd == before.model_sd > 1e-4
    np.testing.assert_allclose(np.diag(after.motion_covariance), np.diag(before.motion_covariance),
                               rtol=0.3)


def test_ignores_isolated_points(points: Array) -> None:
    pose = warm(points)
    before = pose.solution
    pose.add(T_TRACKER_BONE[:3, 3] + 2.0 * (points[::200] - T_TRACKER_BONE[:3, 3]))
    assert pose.solution is before and len(pose.points) == len(points)


def test_uses_a_distant_stroke_once_it_is_dense(points: Array) -> None:
    pose = warm(points[:1000])
    far = points[1100] + np.linspace(0.0, 0.004, 12)[:, None] * [0.0, 0.0, 1.0] + [0.0, 0.0, 0.1]
    for point in far:
        pose.add(point[None])
    assert 1000 < len(pose.points) < 1012


def test_uses_at_most_the_configured_number_of_points(points: Array) -> None:
    pose = warm(points[:600], Config.from_flat({'live.max_points': 640}))
    pose.add(points[600:700])
    pose.add(points[700:])
    assert len(pose.points) == 640


def test_recomputes_neighbourhoods_after_a_large_motion(points: Array) -> None:
    pose = warm(points[:700])
    # as if the neighbourhoods had been computed at a distant pose
    shift = exp([0.0, 0.0, 0.0, 2.0 * NEIGHBOURHOOD_TOLERANCE, 0.0, 0.0])
    pose._T_at_restart = shift @ pose._T_at_restart
    pose.add(points[700:710])
    assert pose._motion() < NEIGHBOURHOOD_TOLERANCE
    assert len(pose._neighbourhood) == 710


def test_adding_many_points_at_once_takes_little_memory(points: Array) -> None:
    pose = warm(points[:600])
    rng = np.random.default_rng(0)
    many = np.repeat(points, 40, axis=0) + 2e-4 * rng.normal(size=(48_000, 3))
    tracemalloc.start()
    pose.add(many)
    pose.add(many)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 60e6      # all distances between them would take 18 GB
    assert 1500 < len(pose.points) <= 2000


def test_does_nothing_once_it_has_enough_points(points: Array) -> None:
    pose = warm(points, Config.from_flat({'live.max_points': 1200}))
    before = pose.solution
    pose.add(np.repeat(points, 100, axis=0))
    assert pose.solution is before and len(pose._cloud) == 1200


def test_landmarks_stay_part_of_the_pose_as_points_are_added(points: Array) -> None:
    places = np.array([[0.3, 0.0, 0.0], [0.0, 0.0, -0.3]])
    # a pose that the points alone would not give: the landmarks are 2 mm off
    marks = Landmarks.of(places, transform(T_TRACKER_BONE, places + [0.0, 0.002, 0.0]),
                         np.full(2, 3e-4))
    few, config = points[:800], CONFIG
    solution = solve(few, bone_field(), NEAR, config.solver)
    pose = WarmPose(few, bone_field(), solution, config, marks)
    alone = warm(few)
    touched = transform(T_TRACKER_BONE, places)
    shift = apart(pose.solution.T_bone_tracker, alone.solution.T_bone_tracker, touched)
    assert shift > 2e-4 and [fit.used for fit in pose.landmark_fits] == [True, True]
    assert pose.covariance is not None and alone.covariance is not None
    assert np.trace(pose.covariance) < 0.5 * np.trace(alone.covariance)
    before = pose.solution.T_bone_tracker
    for point in points[800:1000]:
        pose.add(point[None])
    assert apart(pose.solution.T_bone_tracker, before, touched) < 0.5 * shift
    assert np.trace(pose.covariance) < 0.5 * np.trace(alone.covariance)
