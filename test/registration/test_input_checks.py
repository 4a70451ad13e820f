# SPDX-License-Identifier: Apache-2.0
"""The checks of points and initial guess before a registration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_bone import LANDMARKS, T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError, Reason, Refusal
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.input_checks import (
    MAX_EXTENT_RATIO,
    MIN_EXTENT_RATIO,
    check_points,
    check_selection,
    initial_guess,
)
from gsdf_registration.registration.point_selection import PointSelection, select_points

LIMITS = LimitsConfig(min_extent=0.0)


def line(extent: float) -> Array:
    """Return points along x whose extent between the 5th and the 95th percentile is given, m."""
    points = np.zeros((101, 3))
    points[:, 0] = np.linspace(-0.5, 0.5, 101) * extent / 0.9
    return points


def reason(points: Array, limits: LimitsConfig = LIMITS) -> Reason | None:
    try:
        check_points(points, limits)
        selection = PointSelection(len(points), points, np.arange(len(points)), np.zeros(0), {}, 0)
        check_selection(selection, points, bone_field(), limits)
    except Refusal as refusal:
        return refusal.reason
    return None


@pytest.mark.parametrize(('ratio', 'expected'), [
    (0.99 * MIN_EXTENT_RATIO, Reason.WRONG_UNIT), (1.01 * MIN_EXTENT_RATIO, None),
    (0.99 * MAX_EXTENT_RATIO, None), (1.01 * MAX_EXTENT_RATIO, Reason.WRONG_UNIT)])
def test_the_extent_reveals_a_wrong_unit(ratio: float, expected: Reason | None) -> None:
    assert reason(line(ratio * bone_field().extent)) is expected


def test_points_at_one_place_are_too_small_a_region() -> None:
    assert reason(np.zeros((100, 3)), LimitsConfig()) is Reason.REGION_TOO_SMALL


def test_a_few_places_at_which_the_tip_rested_are_too_few_touches() -> None:
    rng = np.random.default_rng(0)
    rests = np.repeat(touched_points(12), 30, axis=0) + 1e-4 * rng.normal(size=(360, 3))
    with pytest.raises(Refusal, match='0 on strokes and 12 touches, 30 are needed') as refusal:
        check_selection(select_points(rests), rests, bone_field(), LIMITS)
    assert refusal.value.reason is Reason.TOO_FEW_POINTS


def test_the_extent_ignores_outliers() -> None:
    points = line(0.03)
    points[0, 1] = 100.0
    assert reason(points) is None


def test_the_limits_are_inclusive() -> None:
    points = touched_points(30)
    assert reason(points, replace(LIMITS, min_points=30)) is None
    assert reason(points, replace(LIMITS, min_points=31)) is Reason.TOO_FEW_POINTS


def test_a_marker_of_missing_values_is_not_finite() -> None:
    points = touched_points(100)
    points[3, 1] = -3.7e28
    assert reason(points) is Reason.BAD_INPUT


def test_a_pose_takes_precedence_over_landmarks() -> None:
    landmarks = Landmarks.of(LANDMARKS, rigid.transform(T_TRACKER_BONE, LANDMARKS))
    assert initial_guess(None, None) is None
    np.testing.assert_allclose(initial_guess(landmarks, None), rigid.inverse(T_TRACKER_BONE),
                               atol=1e-12)
    np.testing.assert_array_equal(initial_guess(landmarks, np.eye(4)), np.eye(4))


def test_an_initial_pose_must_be_rigid() -> None:
    with pytest.raises(InputError, match='rigid motion'):
        initial_guess(None, 2.0 * np.eye(4))
