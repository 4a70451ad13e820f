# SPDX-License-Identifier: Apache-2.0
"""Of many points a part finds the minima, and the best minima are solved with all points."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration import local_solutions
from gsdf_registration.registration.local_solutions import SAME_MINIMUM, solve_all
from gsdf_registration.registration.pose_selection import select_pose

CONFIG = Config()
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
STARTS = [T_BONE_TRACKER @ rigid.exp([0.02, angle, 0.01, 0.001, 0.0, -0.001])
          for angle in (0.0, 0.01, 0.8, 2.0)]
COUNT = 2000


@pytest.fixture(scope='module')
def points() -> Array:
    return rigid.transform(T_TRACKER_BONE, touched_points(COUNT, 0, 3e-4))


def test_many_points_have_the_minima_of_all(points: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = solve_all(points, bone_field(), STARTS, CONFIG)
    monkeypatch.setattr(local_solutions, 'MANY', 500)
    fast = solve_all(points, bone_field(), STARTS, CONFIG)
    best = [max(found, key=lambda solution: solution.rank) for found in (slow, fast)]
    apart = local_solutions.distance_of_poses(points)
    assert apart(best[0].T_bone_tracker, best[1].T_bone_tracker) < 1e-6
    assert best[1].weights.shape == best[1].residuals.shape == (COUNT,)
    assert best[1].score == pytest.approx(best[0].score, rel=1e-3)
    for each in slow:
        assert min(apart(each.T_bone_tracker, other.T_bone_tracker)
                   for other in fast) < SAME_MINIMUM
    gaps = [[other.gap for other in select_pose(found, points, bone_field(),
                                                CONFIG).alternatives]
            for found in (slow, fast)]
    assert gaps[0] and np.allclose(gaps[0], gaps[1], rtol=0.05)


def test_solutions_of_a_part_never_outrank_those_of_all_points(
        points: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_solutions, 'MANY', 500)
    monkeypatch.setattr(local_solutions, 'FINAL', 1)
    first, *others = solve_all(points, bone_field(), STARTS, CONFIG)
    assert len(others) == 3 and first.weights.shape == (COUNT,)
    assert all(each.rank < first.rank for each in others)


def test_every_touch_counts(points: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_solutions, 'MANY', 500)
    used = []

    def solve(few: Array, *given: object, **options: object) -> object:
        used.append(len(few))
        return real(few, *given, **options)
    real = local_solutions.solve
    monkeypatch.setattr(local_solutions, 'solve', solve)
    touches = np.ones(700)
    found = solve_all(points, bone_field(), STARTS[:1], CONFIG, touches=touches)
    assert used[0] == 500 + 700 and found[0].weights.shape == (COUNT,)


def test_the_published_method_uses_all_points(points: Array,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_solutions, 'MANY', 500)
    (found,) = solve_all(points, bone_field(), STARTS[:1],
                         CONFIG.replaced({'solver.method': 'paper'}))
    assert found.weights.shape == (COUNT,)
