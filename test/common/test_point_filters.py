# SPDX-License-Identifier: Apache-2.0
"""Points on strokes are kept; scattered outliers and duplicates are removed."""

from __future__ import annotations

import numpy as np
from strokes import scattered, stroke

from gsdf_registration.common import rigid
from gsdf_registration.common.point_filters import (
    filter_isolated,
    first_duplicate,
    has_neighbours,
    on_strokes,
)

MOTION = rigid.exp([0.7, -1.9, 0.4, 0.3, -0.8, 0.2])


def test_finds_strokes_among_ten_times_as_many_outliers() -> None:
    points = np.concatenate([stroke(400), scattered(3600)])
    dense = on_strokes(points)
    assert dense[:400].mean() > 0.98
    assert dense[400:].mean() < 0.02


def test_keeps_all_points_if_they_were_captured_one_by_one() -> None:
    assert on_strokes(scattered(60)).all()


def test_keeps_a_stationary_tip_however_many_readings_it_gave() -> None:
    points = np.concatenate([stroke(300), stroke(1) + 3e-4 * np.random.default_rng(0).normal(
        size=(20_000, 3))])
    assert on_strokes(points).mean() > 0.99


def test_is_invariant_under_rigid_motion_and_order() -> None:
    points = np.concatenate([stroke(300), stroke(200, height=0.02), scattered(200)])
    dense = on_strokes(points)
    np.testing.assert_array_equal(on_strokes(rigid.transform(MOTION, points)), dense)
    order = np.random.default_rng(0).permutation(len(points))
    np.testing.assert_array_equal(on_strokes(points[order]), dense[order])


def test_new_points_on_a_stroke_have_neighbours_and_isolated_ones_do_not() -> None:
    points = np.concatenate([stroke(300), scattered(20)])
    assert has_neighbours(points[280:300], points).all()
    assert not has_neighbours(points[300:], points).any()


def test_maps_each_duplicate_to_the_first_occurrence() -> None:
    points = scattered(4)[[0, 1, 0, 2, 1, 0, 3]]
    assert first_duplicate(points).tolist() == [0, 1, 0, 3, 1, 0, 6]
    assert first_duplicate(scattered(5)).tolist() == [0, 1, 2, 3, 4]


def test_filter_keeps_each_position_once() -> None:
    points = np.repeat(stroke(100), 2, axis=0)
    assert filter_isolated(points).tolist() == [True, False] * 100
