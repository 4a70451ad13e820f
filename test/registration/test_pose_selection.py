# SPDX-License-Identifier: Apache-2.0
"""The selected pose under soft tissue and model error, and its alternatives."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, on_plate, plate_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.local_solutions import SAME_MINIMUM, solve_all
from gsdf_registration.registration.pose_selection import select_pose
from gsdf_registration.solver import solve

CONFIG = Config()
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
SIGMA = 3e-4


def under_tissue(share: float, seed: int) -> Array:
    """Return 1000 touched points, a ``share`` of them on tissue 1-4 mm thick on one side."""
    points = touched_points(1000, seed, SIGMA)
    _, gradient = bone_field().sample(points)
    side = points @ np.array([0.3, 1.0, 0.2])
    soft = np.argsort(side)[round(1000 * (1.0 - share)):]
    depth = np.linspace(0.001, 0.004, len(soft))
    points[soft] += depth[:, None] * gradient[soft]
    return rigid.transform(T_TRACKER_BONE, points)


def off(T: Array, points: Array) -> float:
    """Return the error of a pose at the points, RMS, m."""
    apart = rigid.transform(T, points) - rigid.transform(T_BONE_TRACKER, points)
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def near(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return T_BONE_TRACKER @ rigid.exp(np.r_[0.02 * rng.normal(size=3), 0.001 * rng.normal(size=3)])


def test_soft_tissue_biases_single_solutions_but_not_the_selected_pose() -> None:
    alone, chosen = [], []
    for seed in range(3):
        points = under_tissue(0.35, seed)
        alone.append(solve(points, bone_field(), near(seed), CONFIG.solver))
        chosen.append(select_pose(solve_all(points, bone_field(), [near(seed)], CONFIG), points,
                             bone_field(), CONFIG).solution)
        assert off(chosen[-1].T_bone_tracker, points) < 4e-4 and chosen[-1].consistent
    # otherwise the test would be too easy
    assert max(off(solution.T_bone_tracker, points) for solution in alone) > 8e-4


def test_no_further_poses_are_solved_if_all_points_fit() -> None:
    points = under_tissue(0.0, 0)
    assert len(solve_all(points, bone_field(), [near(0), near(1)], CONFIG)) == 2


def test_a_model_error_everywhere_is_allowed_for() -> None:
    points = touched_points(1000, 0)
    _, gradient = bone_field().sample(points)
    wave = 4e-4 * np.sin(points @ np.array([250.0, 180.0, 210.0]))
    points = rigid.transform(T_TRACKER_BONE, points + wave[:, None] * gradient)
    points += 1e-4 * np.random.default_rng(0).normal(size=points.shape)
    chosen = select_pose(solve_all(points, bone_field(), [near(0)], CONFIG), points, bone_field(),
                    CONFIG).solution
    assert (chosen.weights > 0.5).mean() > 0.9 and off(chosen.T_bone_tracker, points) < 6e-4


def test_alternatives_are_distinct_and_sorted_by_likelihood() -> None:
    points = under_tissue(0.0, 1)
    turned = [T_BONE_TRACKER @ rigid.exp([0.0, angle, 0.0, 0.0, 0.0, 0.0]) for angle in (0.8, 2.0)]
    selected = select_pose(solve_all(points, bone_field(), [near(0), *turned], CONFIG), points,
                    bone_field(), CONFIG)
    assert off(selected.solution.T_bone_tracker, points) < 2e-4
    gaps = [other.gap for other in selected.alternatives]
    assert gaps and gaps == sorted(gaps) and gaps[0] > CONFIG.limits.min_gap
    assert all(off(other.T_bone_tracker, points) > 0.9 * SAME_MINIMUM
               for other in selected.alternatives)
    assert selected.runner_up_ratio is not None and selected.runner_up_ratio > 1.0


def test_the_air_decides_on_which_side_of_the_points_the_bone_is() -> None:
    rng = np.random.default_rng(0)
    points = on_plate(rng.uniform(-0.03, 0.03, (400, 2))) + 1e-4 * rng.normal(size=(400, 3))
    above = on_plate(rng.uniform(-0.02, 0.02, (40, 2))) + [0.0, 0.0, 0.012]
    below = above * [1.0, -1.0, -1.0] + [0.0, 0.0, 0.02]
    upright = np.eye(4)
    turned = rigid.from_rt(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.02]))

    def select(starts: list[Array], air: Array) -> tuple[float, int]:
        evidence = Evidence(air=air)
        found = solve_all(points, plate_field(), starts, CONFIG, evidence=evidence)
        chosen = select_pose(found, points, plate_field(), CONFIG, evidence)
        return (float(chosen.solution.T_bone_tracker[2, 2]),
                len(chosen.ambiguous(CONFIG.limits.min_gap)))
    for starts in ([upright, turned], [turned, upright]):
        assert select(starts, np.zeros((0, 3)))[1] == 1
        assert select(starts, above) == (pytest.approx(1.0, abs=0.01), 0)
        assert select(starts, below) == (pytest.approx(-1.0, abs=0.01), 0)
