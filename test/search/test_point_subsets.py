# SPDX-License-Identifier: Apache-2.0
"""Sparse arcs are filtered out, and some subset of the points is free of other objects."""

from __future__ import annotations

import numpy as np
import pytest
from strokes import scattered, stroke

from gsdf_registration.common import rigid
from gsdf_registration.common.downsampling import voxel_downsample
from gsdf_registration.search.point_subsets import filter_sparse, local_subsets

MOTION = rigid.exp([0.7, -1.9, 0.4, 0.3, -0.8, 0.2])


def test_filters_arcs_through_the_air() -> None:
    on_bone, in_air = stroke(400), stroke(60, step=0.0022, height=0.03)
    points = np.concatenate([on_bone, in_air])
    chosen = voxel_downsample(points, 0.002)
    dense = filter_sparse(points, chosen, 0.004)
    assert dense[chosen < len(on_bone)].mean() > 0.7
    assert dense[chosen >= len(on_bone)].mean() < 0.1


def test_keeps_all_points_if_none_has_neighbours() -> None:
    assert filter_sparse(scattered(40), np.arange(40), 0.004).all()


def test_filter_is_invariant_under_rigid_motion_and_order() -> None:
    points = np.concatenate([stroke(300), stroke(200, height=0.02), scattered(200)])
    every = np.arange(len(points))
    dense = filter_sparse(points, every, 0.004)
    np.testing.assert_array_equal(filter_sparse(rigid.transform(MOTION, points), every, 0.004),
                                  dense)
    order = np.random.default_rng(0).permutation(len(points))
    np.testing.assert_array_equal(filter_sparse(points[order], every, 0.004), dense[order])


@pytest.mark.parametrize('place', [(0.0, 0.0, 0.0), (0.05, 0.0, 0.04)], ids=['inside', 'apart'])
def test_some_subset_is_free_of_another_object(place: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(0)
    ring = 0.03 * rng.normal(size=(300, 3)) * [1.0, 1.0, 0.1]
    ring = ring[np.linalg.norm(ring[:, :2], axis=1) > 0.025]
    other = place + 0.008 * rng.normal(size=(200, 3))
    points = np.concatenate([ring, other[:len(ring) * 2 // 3]])
    foreign = {tuple(p) for p in points[len(ring):]}
    shares = [np.mean([tuple(p) in foreign for p in subset]) for subset in local_subsets(points, 7)]
    assert shares[0] == pytest.approx(0.4, abs=0.01)
    assert min(shares) < 0.05


@pytest.mark.parametrize('n', [1, 5, 19, 20, 33, 1000])
def test_subsets_have_at_least_twenty_points_if_there_are_as_many(n: int) -> None:
    points = scattered(n)
    found = local_subsets(points, 4)
    assert len(found) == 1 + 2 * min(n, 4) and found[0] is points
    assert all(min(n, 20) <= len(subset) <= n for subset in found)
