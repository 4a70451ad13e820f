# SPDX-License-Identifier: Apache-2.0
"""Strokes among stray samples, even samples of points, and parts of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.search.point_filters import (
    crowded,
    farthest_point_sample,
    on_strokes,
    parts,
    principal_frame,
    voxel_downsample,
)

MOTION = rigid.exp([0.7, -1.9, 0.4, 0.3, -0.8, 0.2])
seeds = st.integers(0, 2**32 - 1)


def stroke(n: int, step: float = 3.5e-4, at: float = 0.0) -> Array:
    """Return points (n, 3), m, ``step`` apart on a curve, with the noise of a tracker."""
    s = step * np.arange(n)
    rng = np.random.default_rng(n)
    return np.column_stack([0.02 * np.cos(s / 0.02), 0.02 * np.sin(s / 0.02), at + 0.1 * s
                            ]) + 2e-4 * rng.normal(size=(n, 3))


def strewn(n: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).uniform(-0.15, 0.15, (n, 3))


def test_strokes_are_told_from_ten_times_as_many_stray_samples() -> None:
    points = np.concatenate([stroke(400), strewn(3600)])
    dense = on_strokes(points, 0.004)
    assert dense[:400].mean() > 0.98
    assert dense[400:].mean() < 0.02


def test_points_taken_one_by_one_all_count() -> None:
    assert on_strokes(strewn(60), 0.004).all()


def test_a_tip_at_rest_counts_however_often_it_was_read() -> None:
    points = np.concatenate([stroke(300), stroke(1) + 3e-4 * np.random.default_rng(0).normal(
        size=(20_000, 3))])
    assert on_strokes(points, 0.004).mean() > 0.99


@pytest.mark.parametrize('choose', [
    lambda points: np.flatnonzero(on_strokes(points, 0.004)),
    lambda points: np.sort(voxel_downsample(points, 0.002)),
    lambda points: np.flatnonzero(crowded(points, np.arange(len(points)), 0.004)),
    lambda points: farthest_point_sample(points, 20),
], ids=['on_strokes', 'voxel_downsample', 'crowded', 'farthest_point_sample'])
def test_what_is_chosen_moves_with_the_points_and_keeps_no_order(choose) -> None:  # type: ignore
    points = np.concatenate([stroke(300), stroke(200, at=0.02), strewn(200)])
    chosen = points[choose(points)]
    np.testing.assert_array_equal(points[choose(rigid.transform(MOTION, points))], chosen)
    shuffled = points[np.random.default_rng(0).permutation(len(points))]
    again = shuffled[choose(shuffled)]
    np.testing.assert_array_equal(again[np.lexsort(again.T)], chosen[np.lexsort(chosen.T)])


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_one_point_stays_of_each_neighbourhood(seed: int) -> None:
    points = np.random.default_rng(seed).normal(0.0, 0.01, (200, 3))
    chosen = points[voxel_downsample(points, 0.004)]
    gaps = np.linalg.norm(points[:, None] - chosen, axis=2)
    assert len(chosen) < 200 and gaps.min(axis=1).max() < 0.004 * np.sqrt(3.0)


def test_arcs_through_the_air_are_thin() -> None:
    on_bone, in_air = stroke(400), stroke(60, step=0.0022, at=0.03)
    points = np.concatenate([on_bone, in_air])
    dense = crowded(points, voxel_downsample(points, 0.002), 0.004)
    of_bone = voxel_downsample(points, 0.002) < len(on_bone)
    assert dense[of_bone].mean() > 0.7
    assert dense[~of_bone].mean() < 0.1


def test_where_no_point_has_neighbours_none_is_left_out() -> None:
    points = strewn(40)
    assert crowded(points, np.arange(40), 0.004).all()


@given(seeds, st.integers(1, 60))
@settings(max_examples=20, deadline=None)
def test_each_point_of_a_sample_is_the_farthest_from_those_before(seed: int, n: int) -> None:
    points = np.random.default_rng(seed).normal(size=(n, 3))
    chosen = farthest_point_sample(points, 20)
    assert len(chosen) == len(set(chosen.tolist())) == min(n, 20)
    for i in range(1, len(chosen)):
        gaps = np.linalg.norm(points[:, None] - points[chosen[:i]], axis=2).min(axis=1)
        assert gaps[chosen[i]] == pytest.approx(gaps.max())


def test_some_part_is_free_of_another_object() -> None:
    rng = np.random.default_rng(0)
    ring = 0.03 * rng.normal(size=(300, 3)) * [1.0, 1.0, 0.1]
    apart = np.array([0.05, 0.0, 0.04])
    for place in (np.zeros(3), apart):
        thing = place + 0.008 * rng.normal(size=(200, 3)) / [1.0, 1.0, 1.0]
        ring = ring[np.linalg.norm(ring[:, :2], axis=1) > 0.025]
        points = np.concatenate([ring, thing[:len(ring) * 2 // 3]])
        foreign = {tuple(p) for p in points[len(ring):]}
        shares = [np.mean([tuple(p) in foreign for p in part]) for part in parts(points, 7)]
        assert shares[0] == pytest.approx(0.4, abs=0.01)
        assert min(shares) < 0.05


@pytest.mark.parametrize('n', [1, 5, 19, 20, 33, 1000])
def test_parts_hold_at_least_twenty_points_if_there_are_so_many(n: int) -> None:
    points = strewn(n)
    found = parts(points, 4)
    assert len(found) == 1 + 2 * min(n, 4) and found[0] is points
    assert all(min(n, 20) <= len(part) <= n for part in found)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_the_points_own_frame_is_rigid_and_moves_with_them(seed: int) -> None:
    points = np.random.default_rng(seed).gamma(2.0, [0.01, 0.02, 0.005], (50, 3))
    T = principal_frame(points)
    assert rigid.is_rigid(T, 1e-9)
    own = rigid.transform(T, points)
    np.testing.assert_allclose(own.mean(axis=0), 0.0, atol=1e-12)
    assert (np.diff(own.std(axis=0)) <= 0.0).all()
    moved = rigid.transform(MOTION, points)
    np.testing.assert_allclose(rigid.transform(principal_frame(moved), moved), own, atol=1e-9)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_however_few_points_have_a_frame_of_their_own(n: int) -> None:
    assert rigid.is_rigid(principal_frame(strewn(n)), 1e-9)
