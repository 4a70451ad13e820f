# SPDX-License-Identifier: Apache-2.0
"""Downsampling by voxels and farthest points, and the principal frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common import rigid
from gsdf_registration.common.downsampling import (
    farthest_point_sample,
    principal_frame,
    voxel_downsample,
)
from gsdf_registration.common.rigid import Array

MOTION = rigid.exp([0.7, -1.9, 0.4, 0.3, -0.8, 0.2])
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize('select', [
    lambda points: np.sort(voxel_downsample(points, 0.002)),
    lambda points: farthest_point_sample(points, 20),
], ids=['voxel_downsample', 'farthest_point_sample'])
def test_is_invariant_under_rigid_motion_and_order(select: Callable[[Array], np.ndarray]) -> None:
    rng = np.random.default_rng(1)
    points = np.concatenate([rng.gamma(2.0, 0.005, (500, 3)), rng.uniform(-0.15, 0.15, (200, 3))])
    chosen = points[select(points)]
    np.testing.assert_array_equal(points[select(rigid.transform(MOTION, points))], chosen)
    shuffled = rng.permutation(points)
    again = shuffled[select(shuffled)]
    np.testing.assert_array_equal(again[np.lexsort(again.T)], chosen[np.lexsort(chosen.T)])


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_voxel_downsample_keeps_a_point_near_every_point(seed: int) -> None:
    points = np.random.default_rng(seed).normal(0.0, 0.01, (200, 3))
    chosen = points[voxel_downsample(points, 0.004)]
    gaps = np.linalg.norm(points[:, None] - chosen, axis=2)
    assert len(chosen) < 200 and gaps.min(axis=1).max() < 0.004 * np.sqrt(3.0)


@given(seeds, st.integers(1, 60))
@settings(max_examples=20, deadline=None)
def test_each_sampled_point_is_farthest_from_the_previous_ones(seed: int, n: int) -> None:
    points = np.random.default_rng(seed).normal(size=(n, 3))
    chosen = farthest_point_sample(points, 20)
    assert len(chosen) == len(set(chosen.tolist())) == min(n, 20)
    for i in range(1, len(chosen)):
        gaps = np.linalg.norm(points[:, None] - points[chosen[:i]], axis=2).min(axis=1)
        assert gaps[chosen[i]] == pytest.approx(gaps.max())


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_principal_frame_is_rigid_and_moves_with_the_points(seed: int) -> None:
    points = np.random.default_rng(seed).gamma(2.0, [0.01, 0.02, 0.005], (50, 3))
    T = principal_frame(points)
    assert rigid.is_rigid(T, 1e-9)
    local = rigid.transform(T, points)
    np.testing.assert_allclose(local.mean(axis=0), 0.0, atol=1e-12)
    assert (np.diff(local.std(axis=0)) <= 0.0).all()
    moved = rigid.transform(MOTION, points)
    np.testing.assert_allclose(rigid.transform(principal_frame(moved), moved), local, atol=1e-9)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_principal_frame_of_few_points_is_rigid(n: int) -> None:
    points = np.random.default_rng(1).uniform(-0.15, 0.15, (n, 3))
    assert rigid.is_rigid(principal_frame(points), 1e-9)
