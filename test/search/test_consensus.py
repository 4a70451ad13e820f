# SPDX-License-Identifier: Apache-2.0
"""Sample consensus finds the pose where soft tissue attracts every local solution."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.rigid import Array, rms_displacement
from gsdf_registration.search.consensus import POSE_ERROR, SEPARATION, consensus
from gsdf_registration.solver import nearest_neighbours, solve

N, SOFT = 1000, 400     # points, of which 40 % are on soft tissue
COUNT = 48              # poses requested
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
CONFIG = SolverConfig()
SEEDS = (0, 2, 4)


def measured(seed: int) -> Array:
    """Return noisy points (n, 3), tracker frame, the last `SOFT` 1-4 mm outside, on one side."""
    points = touched_points(N, seed, 3e-4, radius=0.06)
    points = points[np.argsort(points @ np.array([0.3, 1.0, 0.2]))]
    _, gradient = bone_field().sample(points[-SOFT:])
    points[-SOFT:] += np.linspace(0.001, 0.004, SOFT)[:, None] * gradient
    return rigid.transform(T_TRACKER_BONE, points)


def found_from(points: Array, T_bone_tracker: Array, count: int = COUNT) -> Array:
    neighbours = nearest_neighbours(points, bone_field(), T_bone_tracker)
    return consensus(points, bone_field(), T_bone_tracker, neighbours, count)


@cache
def attracted(seed: int) -> tuple[Array, Array]:
    """Return points, and the local solution near the true pose, which the soft tissue attracts."""
    points, rng = measured(seed), np.random.default_rng(seed)
    initial = T_BONE_TRACKER @ rigid.exp(np.r_[0.02 * rng.normal(size=3),
                                               0.001 * rng.normal(size=3)])
    return points, solve(points, bone_field(), initial, CONFIG).T_bone_tracker


@pytest.mark.parametrize('seed', SEEDS)
def test_finds_the_pose_if_40_percent_of_the_points_are_soft_tissue(seed: int) -> None:
    points, initial = attracted(seed)
    on_bone = points[:-SOFT]
    assert rms_displacement(initial, T_BONE_TRACKER, on_bone) > 3e-3
    errors = [rms_displacement(T, T_BONE_TRACKER, on_bone) for T in found_from(points, initial)]
    assert min(errors) < POSE_ERROR


@pytest.mark.parametrize('seed', SEEDS)
def test_best_local_solution_from_the_poses_rejects_the_soft_tissue(seed: int) -> None:
    points, initial = attracted(seed)
    neighbours = nearest_neighbours(points, bone_field(), initial)
    best = max((solve(points, bone_field(), T, CONFIG, neighbours=neighbours, local_sd=POSE_ERROR)
                for T in found_from(points, initial)), key=lambda solution: solution.rank)
    assert best.consistent
    assert rms_displacement(best.T_bone_tracker, T_BONE_TRACKER, points[:-SOFT]) < POSE_ERROR
    assert (best.weights[:-SOFT] > 0.5).mean() > 0.85
    assert (best.weights[-SOFT:] > 0.5).mean() < 0.3


def test_is_deterministic() -> None:
    points, initial = attracted(0)
    np.testing.assert_array_equal(found_from(points, initial), found_from(points, initial))


def test_poses_are_rigid_and_distinct() -> None:
    points, initial = attracted(0)
    found = found_from(points, initial)
    assert len(found) > 1
    assert all(rigid.is_rigid(T, 1e-9) for T in found)
    assert min(rms_displacement(a, b, points) for i, a in enumerate(found)
               for b in found[:i]) > 0.99 * SEPARATION


@pytest.mark.parametrize('count', [1, 5])
def test_returns_at_most_the_requested_number(count: int) -> None:
    points, initial = attracted(0)
    np.testing.assert_array_equal(found_from(points, initial, count),
                                  found_from(points, initial)[:count])


def test_is_invariant_under_rigid_motion() -> None:
    points, initial = attracted(0)
    motion = rigid.exp([2.0, -1.0, 0.5, 0.3, -0.2, 0.4])
    moved = found_from(rigid.transform(motion, points), initial @ rigid.inverse(motion), 3)
    for pose, expected in zip(moved @ motion, found_from(points, initial, 3)):
        assert rms_displacement(pose, expected, points) < 1e-5
