# SPDX-License-Identifier: Apache-2.0
"""Start rotations cover SO(3), and only distinct poses are kept."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.search.start_poses import (
    Poses,
    distinct,
    rotated_starts,
    super_fibonacci,
)

seeds = st.integers(0, 2**32 - 1)


def random_poses(m: int, seed: int, size: float = 1.0) -> Poses:
    rng = np.random.default_rng(seed)
    twists = size * rng.normal(size=(m, 6)) * [1.0, 1.0, 1.0, 0.02, 0.02, 0.02]
    T = np.array([rigid.exp(x) for x in twists])
    return Poses(T[:, :3, :3].copy(), T[:, :3, 3].copy())


def angle(a: Array, b: Array) -> Array:
    """Return the angles (m,), rad, between rotations ``a`` (m, 3, 3) and ``b`` (3, 3)."""
    return np.arccos(np.clip((np.einsum('mij,ij->m', a, b) - 1.0) / 2.0, -1.0, 1.0))


def test_rotations_cover_all_attitudes() -> None:
    rotations = super_fibonacci(200)
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, 1, 2),
                               np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    rng = np.random.default_rng(0)
    nearest = [
        angle(rotations, rigid.rotation_from_quaternion(q)).min() for q in rng.normal(size=(500, 4))
    ]
    assert np.degrees(max(nearest)) < 40.0 and np.degrees(np.mean(nearest)) < 25.0


def test_initial_pose_comes_first_and_rotations_keep_the_origin() -> None:
    T = rigid.exp([0.4, 2.0, -0.3, 0.1, 0.2, 0.3])
    poses = rotated_starts(T)
    np.testing.assert_array_equal(poses.R[0], T[:3, :3])
    np.testing.assert_array_equal(poses.t, np.tile(T[:3, 3], (len(poses.t), 1)))
    angles = np.degrees(angle(poses.R[1:], T[:3, :3]))
    np.testing.assert_allclose(angles, np.repeat([10.0, 20.0, 30.0], 26), atol=1e-6)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_change_of_origin_moves_no_point(seed: int) -> None:
    poses, rng = random_poses(5, seed), np.random.default_rng(seed)
    points, origin = rng.normal(size=(10, 3)), rng.normal(size=3)
    before = points @ np.swapaxes(poses.R, 1, 2) + poses.t[:, None]
    R, t = poses.with_origin(origin)
    np.testing.assert_allclose((points - origin) @ np.swapaxes(R, 1, 2) + t[:, None], before,
                               atol=1e-12)


@given(seeds, st.integers(1, 40))
@settings(max_examples=20, deadline=None)
def test_keeps_the_first_of_each_group_of_similar_poses(seed: int, count: int) -> None:
    poses = random_poses(60, seed, 0.3)
    points = np.random.default_rng(seed).normal(0.0, 0.02, (30, 3))
    placed = points @ np.swapaxes(poses.R, 1, 2) + poses.t[:, None]
    expected: list[int] = []
    for k in range(60):
        gaps = [np.sqrt(((placed[k] - placed[j])**2).sum(axis=1).mean()) for j in expected]
        if len(expected) < count and (not gaps or min(gaps) >= 0.01):
            expected.append(k)
    # the origin must be the centroid: rotation and translation separate only there
    centroid = points.mean(axis=0)
    found = distinct(*poses.with_origin(centroid), points - centroid, 0.01, count)
    assert found.tolist() == expected


def test_concatenates_and_selects_in_order() -> None:
    a, b = random_poses(3, 0), random_poses(2, 1)
    both = Poses.concatenated([a, b])
    np.testing.assert_array_equal(both.select(np.array([4, 0])).t, [b.t[1], a.t[0]])
