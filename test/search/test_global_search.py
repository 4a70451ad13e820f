# SPDX-License-Identifier: Apache-2.0
"""The global search finds the pose among interference, and always the same one."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, Refusal
from gsdf_registration.common.rigid import Array, rms_displacement
from gsdf_registration.search.global_search import START_POSES, VOXEL, find_start_poses

SEARCH = Config().search
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)


def measured(n: int = 600, seed: int = 0, T_tracker_bone: Array = T_TRACKER_BONE) -> Array:
    return rigid.transform(T_tracker_bone, touched_points(n, seed, 3e-4))


@pytest.mark.parametrize('seed', range(3))
def test_finds_any_attitude(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = rigid.from_rt(rigid.rotation_from_quaternion(rng.normal(size=4)),
                      rng.uniform(-1.0, 1.0, 3))
    points = measured(seed=seed, T_tracker_bone=T)
    best = find_start_poses(points, bone_field(), SEARCH)[0]
    assert rms_displacement(best, rigid.inverse(T), points) < 1e-3


@pytest.mark.parametrize('place', [(0.06, 0.0, 0.0), (0.045, 0.03, 0.03)], ids=['above', 'beside'])
def test_finds_the_pose_with_strokes_on_another_object(place: Array) -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(400, 3))
    ball = place + 0.014 * ball / np.linalg.norm(ball, axis=1)[:, None]
    points = measured()
    both = np.concatenate([points, rigid.transform(T_TRACKER_BONE, ball)])
    best = find_start_poses(both, bone_field(), SEARCH)[0]
    assert rms_displacement(best, T_BONE_TRACKER, points) < 1e-3


def test_finds_the_pose_with_arcs_through_the_air() -> None:
    rng = np.random.default_rng(0)
    s = np.linspace(0.0, np.pi, 70)[:, None]
    ends = touched_points(12, 3)
    arcs = [a + (b - a) * s / np.pi + [0.03, 0.0, 0.0] * np.sin(s)
            for a, b in zip(ends[:6], ends[6:])]
    points = measured()
    air = rigid.transform(T_TRACKER_BONE, np.concatenate(arcs))
    both = rng.permutation(np.concatenate([points, air]))
    best = find_start_poses(both, bone_field(), SEARCH)[0]
    assert rms_displacement(best, T_BONE_TRACKER, points) < 1e-3


def test_is_invariant_to_order_threads_and_rigid_motion() -> None:
    points = measured(400)
    found = find_start_poses(points, bone_field(), SEARCH)
    one = Config.from_flat({'search.threads': 1}).search
    np.testing.assert_array_equal(find_start_poses(points, bone_field(), one), found)
    shuffled = np.random.default_rng(0).permutation(points)
    np.testing.assert_allclose(find_start_poses(shuffled, bone_field(), SEARCH)[:3], found[:3],
                               atol=1e-5)
    motion = rigid.exp([2.0, -1.0, 0.5, 0.3, -0.2, 0.4])
    moved = find_start_poses(rigid.transform(motion, points), bone_field(), SEARCH)
    np.testing.assert_allclose(moved[:3] @ motion, found[:3], atol=1e-5)


def test_poses_are_rigid_and_distinct_best_first() -> None:
    points = measured(400)
    found = find_start_poses(points, bone_field(), SEARCH)
    assert 1 < len(found) <= START_POSES
    assert all(rigid.is_rigid(T, 1e-9) for T in found)
    assert min(rms_displacement(a, b, points) for i, a in enumerate(found)
               for b in found[:i]) > 0.9 * VOXEL
    residual = [np.median(np.abs(bone_field().sample(rigid.transform(T, points))[0]))
                for T in found]
    assert np.argmin(residual) == 0


def test_searches_around_an_initial_pose() -> None:
    points = measured(400)
    centroid = points.mean(axis=0)
    rotation = rigid.from_rt(rigid.rotation_exp([0.25, -0.2, 0.2]), np.zeros(3))
    to_centroid = rigid.from_rt(np.eye(3), -centroid)
    guess = T_BONE_TRACKER @ rigid.inverse(to_centroid) @ rotation @ to_centroid
    guess[:3, 3] += 0.012
    found = find_start_poses(points, bone_field(), SEARCH, guess)
    assert rms_displacement(found[0], T_BONE_TRACKER, points) < 1e-3


@pytest.mark.parametrize('guess', [None, T_BONE_TRACKER], ids=['anywhere', 'guess'])
def test_progress_increases_to_one(guess: Array | None) -> None:
    shares: list[float] = []
    find_start_poses(measured(200), bone_field(), SEARCH, guess, progress=shares.append)
    assert len(shares) > 3 and shares == sorted(shares)
    assert shares[0] > 0.0 and shares[-1] == pytest.approx(1.0)


def test_search_can_be_cancelled_immediately() -> None:
    shares: list[float] = []
    with pytest.raises(Refusal) as refusal:
        find_start_poses(measured(200), bone_field(), SEARCH, cancelled=lambda: True,
                         progress=shares.append)
    assert refusal.value.reason is Reason.NOT_CONVERGED and not shares


@pytest.mark.parametrize('n', [3, 10, 30])
def test_accepts_few_points(n: int) -> None:
    found = find_start_poses(measured(n), bone_field(), SEARCH)
    assert np.isfinite(found).all() and len(found) >= 1
