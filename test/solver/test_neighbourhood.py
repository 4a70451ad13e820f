# SPDX-License-Identifier: Apache-2.0
"""Nearest neighbours along the bone, for a fixed and for a growing set of points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver import Neighbourhood, nearest_neighbours
from gsdf_registration.solver.neighbourhood import PROJECTED

T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)


def noisy(n: int, seed: int = 0) -> Array:
    return rigid.transform(T_TRACKER_BONE, touched_points(n, seed, 1e-3))


@given(st.integers(0, 20), st.integers(1, 60), st.lists(st.integers(0, 40), max_size=6),
       st.integers(2, 20))
@settings(deadline=None, max_examples=40)
def test_adding_points_gives_the_neighbours_of_all_points(
        seed: int, first: int, added: list[int], count: int) -> None:
    points = noisy(first + sum(added), seed)
    grown = Neighbourhood(points[:first], bone_field(), T_BONE_TRACKER, count)
    for n in added:
        grown.add(points[len(grown):len(grown) + n])
    assert len(grown) == len(points)
    np.testing.assert_array_equal(
        grown.indices, nearest_neighbours(points, bone_field(), T_BONE_TRACKER, count))


def test_neighbours_are_sorted_by_distance_along_the_bone_itself_first() -> None:
    points = noisy(300)
    nearest = nearest_neighbours(points, bone_field(), T_BONE_TRACKER, 10)
    assert (nearest[:, 0] == np.arange(300)).all()
    placed = rigid.transform(T_BONE_TRACKER, points)
    distance, gradient = bone_field().sample(placed)
    projected = placed - PROJECTED * distance[:, None] * gradient
    distances = np.linalg.norm(projected[:, None] - projected, axis=2)
    np.testing.assert_array_equal(nearest, np.argsort(distances, axis=1)[:, :10])


def test_neighbours_of_a_stationary_tip_contain_no_duplicates() -> None:
    points = noisy(50)
    grown = Neighbourhood(points, bone_field(), T_BONE_TRACKER, 8)
    grown.add(np.repeat(points[:1], 30, axis=0))    # the same position many times
    assert all(len(set(row.tolist())) == 8 for row in grown.indices)
    assert (grown.indices[:, 0] == np.arange(80)).all()


@pytest.mark.parametrize('count', [4, 16])
def test_does_not_modify_its_input(count: int) -> None:
    points = noisy(8)
    before = points.copy()
    grown = Neighbourhood(points, bone_field(), T_BONE_TRACKER, count)
    for _ in range(3):
        grown.add(points + 0.001)
    np.testing.assert_array_equal(points, before)
