# SPDX-License-Identifier: Apache-2.0
"""Poses between two known ones are interpolated, and never extrapolated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.rigid import (
    Array,
    angle_between,
    exp,
    from_rt,
    inverse,
    is_rigid,
    transform,
)
from gsdf_registration.tracking.pose_buffer import DURATION, MAX_POSES, LookupStatus, PoseBuffer

GAP = 0.5       # s
twists = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)
ratios = st.floats(0.0, 1.0)


def buffer(*poses: tuple[float, Array]) -> PoseBuffer:
    made = PoseBuffer()
    assert [made.add(stamp, T) for stamp, T in poses] == [''] * len(poses)
    return made


@settings(deadline=None)
@given(twists, twists, ratios)
def test_interpolates_translation_linearly_and_rotation_by_slerp(a: Array, b: Array,
                                                                 ratio: float) -> None:
    T_a, T_b = exp(a), exp(b)
    T = buffer((1.0, T_a), (1.4, T_b)).at(1.0 + 0.4 * ratio, GAP)
    assert is_rigid(T, 1e-9)
    np.testing.assert_allclose(T[:3, 3], (1.0 - ratio) * T_a[:3, 3] + ratio * T_b[:3, 3], atol=1e-9)
    angle = angle_between(T_a[:3, :3], T_b[:3, :3])
    assert angle_between(T_a[:3, :3], T[:3, :3]) == pytest.approx(ratio * angle, abs=1e-6)
    assert angle_between(T[:3, :3], T_b[:3, :3]) == pytest.approx((1.0 - ratio) * angle, abs=1e-6)


@settings(deadline=None)
@given(twists, twists)
def test_interpolation_error_of_a_constant_twist_is_bounded(start: Array, twist: Array) -> None:
    """The rotation is exact at any rate, the translation off by |w x v| dt^2 / 8 at most."""
    period = 0.0125
    a, middle, b = (exp(start) @ exp(time * twist) for time in (0.0, 0.5 * period, period))
    T = buffer((0.0, a), (period, b)).at(0.5 * period, GAP)
    assert angle_between(T[:3, :3], middle[:3, :3]) < 1e-7
    bound = np.linalg.norm(twist[:3]) * np.linalg.norm(twist[3:]) * period**2 / 8.0
    assert np.linalg.norm(T[:3, 3] - middle[:3, 3]) <= 1.01 * bound + 1e-12


@settings(deadline=None)
@given(twists, twists, twists, ratios)
def test_interpolation_does_not_depend_on_the_tracker_frame(
        moved: Array, a: Array, b: Array, ratio: float) -> None:
    T_moved, point, stamp = exp(moved), np.array([0.1, -0.2, 0.3]), 1.0 + 0.4 * ratio
    here = buffer((1.0, exp(a)), (1.4, exp(b))).at(stamp, GAP)
    there = buffer((1.0, T_moved @ exp(a)), (1.4, T_moved @ exp(b))).at(stamp, GAP)
    np.testing.assert_allclose(transform(inverse(there), transform(T_moved, point)),
                               transform(inverse(here), point), atol=1e-7)


def test_returns_the_pose_at_its_own_stamp() -> None:
    T = exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    made = buffer((1.0, T))
    assert made.at(1.0, 0.0) is T
    made.add(9.0, np.eye(4))
    assert made.at(1.0, 0.0) is T


def test_does_not_extrapolate_or_interpolate_over_gaps() -> None:
    assert PoseBuffer().at(1.0, GAP) is LookupStatus.NOT_YET
    made = buffer((1.0, np.eye(4)), (1.1, np.eye(4)))
    assert made.at(0.999, GAP) is LookupStatus.NEVER
    assert made.at(1.101, GAP) is LookupStatus.NOT_YET
    made.add(1.7, np.eye(4))
    assert made.at(1.3, GAP) is LookupStatus.NEVER
    assert isinstance(made.at(1.3, 0.61), np.ndarray)


@pytest.mark.parametrize('T', [
    np.full((4, 4), np.nan), 2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]),
    from_rt(np.eye(3), [-3.7e28, 0.0, 0.0]), np.zeros((4, 4))],
    ids=['NaN', 'scaled', 'mirrored', 'the huge numbers of a missing tool', 'zero'])
def test_rejects_poses_that_are_not_rigid(T: Array) -> None:
    made = buffer((1.0, np.eye(4)))
    assert 'not a rigid motion' in made.add(1.1, T)
    assert made.add(np.nan, np.eye(4))
    assert made.newest == 1.0


def test_rejects_repeated_and_late_poses() -> None:
    made = buffer((1.0, np.eye(4)), (1.1, np.eye(4)))
    for stamp in (1.1, 1.05, 0.2):
        assert 'not later' in made.add(stamp, exp([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_array_equal(made.at(1.05, GAP), np.eye(4))


def test_a_clock_that_goes_back_clears_the_buffer() -> None:
    made, old, new = PoseBuffer(), np.eye(4), exp([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    for i in range(400):
        made.add(1000.0 + i / 80.0, old)
    for i in range(10):
        assert made.add(1000.0 + i / 80.0, new) == ''
    assert made.newest == 1000.0 + 9 / 80.0
    np.testing.assert_allclose(made.at(1000.01, GAP), new, atol=1e-12)


def test_rewind_drops_earlier_and_still_arriving_poses() -> None:
    made = buffer((1000.0, np.eye(4)), (1000.1, np.eye(4)))
    made.rewind(999.9)
    assert made.newest == 1000.1
    made.rewind(900.0)
    assert made.at(1000.0, GAP) is LookupStatus.NOT_YET
    assert 'jumps' in made.add(1000.2, np.eye(4))
    assert made.at(900.05, GAP) is LookupStatus.NOT_YET
    assert made.add(900.1, np.eye(4)) == '' and made.newest == 900.1


@pytest.mark.parametrize('rate', [80.0, 1e6])
def test_memory_is_bounded(rate: float) -> None:
    made = PoseBuffer()
    for i in range(50_000):
        made.add(1000.0 + i / rate, np.eye(4))
    assert len(made._poses) == len(made._stamps) == len(made._turns) <= MAX_POSES
    kept = made.newest - made._stamps[0]
    assert kept <= 2.0 * DURATION
    assert kept >= 0.99 * DURATION or len(made._poses) >= MAX_POSES // 2
