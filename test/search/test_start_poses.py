# SPDX-License-Identifier: Apache-2.0
"""Where a search starts, and which poses it tells apart."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.search.start_poses import Poses, around, distinct, super_fibonacci

seeds = st.integers(0, 2**32 - 1)


def some(m: int, seed: int, size: float = 1.0) -> Poses:
    rng = np.random.default_rng(seed)
    twists = size * rng.normal(size=(m, 6)) * [1.0, 1.0, 1.0, 0.02, 0.02, 0.02]
    T = np.array([rigid.exp(x) for x in twists])
    return Poses(T[:, :3, :3].copy(), T[:, :3, 3].copy())


def angle(a: Array, b: Array) -> Array:
    """Return the angles (m,), rad, between rotations ``a`` (m, 3, 3) and ``b`` (3, 3)."""
    return np.arccos(np.clip((np.einsum('mij,ij->m', a, b) - 1.0) / 2.0, -1.0, 1.0))


def test_rotations_leave_no_gap() -> None:
    rotations = super_fibonacci(200)
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, 1, 2),
                               np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    rng = np.random.default_rng(0)
    nearest = [
        angle(rotations, rigid.rotation_from_quaternion(q)).min() for q in rng.normal(size=(500, 4))
    ]
    assert np.degrees(max(nearest)) < 40.0 and np.degrees(np.mean(nearest)) < 25.0


def test_a_guess_comes_first_and_all_turns_keep_the_centre() -> None:
    T = rigid.exp([0.4, 2.0, -0.3, 0.1, 0.2, 0.3])
    poses = around(T)
    np.testing.assert_array_equal(poses.R[0], T[:3, :3])
    np.testing.assert_array_equal(poses.t, np.tile(T[:3, 3], (len(poses.t), 1)))
    turned = np.degrees(angle(poses.R[1:], T[:3, :3]))
    np.testing.assert_allclose(turned, np.repeat([10.0, 20.0, 30.0], 26), atol=1e-6)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_another_centre_moves_no_point(seed: int) -> None:
    poses, rng = some(5, seed), np.random.default_rng(seed)
    points, centre = rng.normal(size=(10, 3)), rng.normal(size=3)
    before = points @ np.swapaxes(poses.R, 1, 2) + poses.t[:, None]
    R, t = poses.about(centre)
    np.testing.assert_allclose((points - centre) @ np.swapaxes(R, 1, 2) + t[:, None], before,
                               atol=1e-12)


@given(seeds, st.integers(1, 40))
@settings(max_examples=20, deadline=None)
def test_the_first_of_each_group_stays(seed: int, count: int) -> None:
    poses = some(60, seed, 0.3)
    points = np.random.default_rng(seed).normal(0.0, 0.02, (30, 3))
    placed = points @ np.swapaxes(poses.R, 1, 2) + poses.t[:, None]
    slow: list[int] = []
    for k in range(60):
        gaps = [np.sqrt(((placed[k] - placed[j])**2).sum(axis=1).mean()) for j in slow]
        if len(slow) < count and (not gaps or min(gaps) >= 0.01):
            slow.append(k)
    # the centre must be the points': elsewhere shift and turn do not separate
    middle = points.mean(axis=0)
    assert distinct(*poses.about(middle), points - middle, 0.01, count).tolist() == slow


def test_poses_are_joined_and_picked_in_order() -> None:
    a, b = some(3, 0), some(2, 1)
    both = Poses.joined([a, b])
    np.testing.assert_array_equal(both.pick(np.array([4, 0])).t, [b.t[1], a.t[0]])
