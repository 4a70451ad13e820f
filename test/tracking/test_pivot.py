# SPDX-License-Identifier: Apache-2.0
"""The fixed point of a moving body: accuracy, covariance, faults in the data, rejections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from gsdf_registration.common.rigid import Array, exp, inverse, transform
from gsdf_registration.simulation.pivoting import (
    PivotRecording,
    PoseFaults,
    PoseKind,
    PoseNoise,
    Turning,
    leg_swing,
    pivoting,
)
from gsdf_registration.tracking.pivot import (
    PIVOT,
    FixedPoint,
    PivotReason,
    calibrate_pivot,
    find_fixed_point,
    find_joint_centre,
)

EXACT = PoseNoise(0.0, 0.0)
twists = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)
seeds = st.integers(0, 2**32 - 1)
Record = Callable[[np.random.Generator], PivotRecording]


def record(seed: int = 0, seconds: float = 10.0, **options: object) -> PivotRecording:
    return pivoting(np.random.default_rng(seed), seconds, 20.0, **options)


def calibrated(recording: PivotRecording) -> FixedPoint:
    return calibrate_pivot(recording.T_tracker_body, recording.stamps)


def error_of(result: FixedPoint, recording: PivotRecording) -> float:
    assert result.success, result.message
    return float(np.linalg.norm(result.point - recording.point))


def test_exact_poses_give_the_exact_point() -> None:
    recording = record(noise=EXACT)
    result = calibrated(recording)
    assert error_of(result, recording) < 1e-12
    np.testing.assert_allclose(result.centre, recording.centre, atol=1e-12)
    assert result.residual_rms < 1e-12 and result.error < 1e-12
    assert result.used.all() and not any(result.rejected.values())
    assert 'expected error < 0.1 mm' in result.message


def test_noise_averages_out_over_many_poses() -> None:
    recording = record()
    assert error_of(calibrated(recording), recording) < 2e-4


def test_a_pose_range_is_reported_as_angles() -> None:
    recording = record(noise=EXACT, turning=Turning(np.radians(20.0), 0.0), seconds=60.0)
    result = calibrated(recording)
    assert np.degrees(result.angle_range) == pytest.approx(40.0, abs=2.0)
    assert result.angles.shape == (3,) and np.degrees(result.angles[:2]).min() > 35.0


def test_noise_of_the_orientation_does_not_pull_the_tip_to_the_origin() -> None:
    """Plain least squares is 0.15 mm too short here."""
    errors = []
    for seed in range(30):
        recording = pivoting(np.random.default_rng(seed), 60.0, 60.0,
                             noise=PoseNoise(0.0002, np.radians(0.3)))
        errors.append(calibrated(recording).point - recording.point)
    along = np.mean(errors, axis=0) @ recording.point / np.linalg.norm(recording.point)
    assert abs(along) < 3e-5


@settings(deadline=None, max_examples=25)
@given(seeds, twists)
def test_moving_the_tracker_moves_only_the_pivot(seed: int, twist: Array) -> None:
    recording, G = record(seed), exp(twist)
    here = calibrated(recording)
    there = calibrate_pivot(G @ recording.T_tracker_body, recording.stamps)
    np.testing.assert_allclose(there.point, here.point, atol=1e-9)
    np.testing.assert_allclose(there.centre, transform(G, here.centre), atol=1e-9)
    assert there.error == pytest.approx(here.error, rel=1e-6)
    np.testing.assert_allclose(there.covariance[:3, :3], here.covariance[:3, :3], rtol=1e-5,
                               atol=1e-14)


@settings(deadline=None, max_examples=25)
@given(seeds, twists)
def test_another_tool_frame_has_the_same_tip(seed: int, twist: Array) -> None:
    recording, B = record(seed, noise=EXACT), exp(twist)
    result = calibrate_pivot(recording.T_tracker_body @ B, recording.stamps)
    np.testing.assert_allclose(result.point, transform(inverse(B), recording.point), atol=1e-9)
    np.testing.assert_allclose(result.centre, recording.centre, atol=1e-9)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_the_order_of_stamped_poses_does_not_matter(seed: int) -> None:
    recording = record(seed, faults=PoseFaults(slips=((6.0, 0.004),), wrong=0.05))
    order = np.random.default_rng(seed).permutation(len(recording.stamps))
    sorted_, shuffled = calibrated(recording), calibrate_pivot(recording.T_tracker_body[order],
                                                               recording.stamps[order])
    assert shuffled.reason is sorted_.reason
    np.testing.assert_array_equal(shuffled.used, sorted_.used[order])
    if sorted_.success:
        np.testing.assert_allclose(shuffled.point, sorted_.point, atol=1e-12)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_the_order_of_poses_without_stamps_does_not_move_the_tip(seed: int) -> None:
    recording = record(seed)
    order = np.random.default_rng(seed).permutation(len(recording.stamps))
    here, there = (calibrate_pivot(recording.T_tracker_body[rows]) for rows in
                   (np.arange(len(order)), order))
    assert here.used[order].sum() == there.used.sum()
    np.testing.assert_allclose(there.point, here.point, atol=1e-9)


def test_lengths_scale_with_the_limits() -> None:
    recording = record(faults=PoseFaults(slips=((6.0, 0.004),), wrong=0.05))
    metres = calibrated(recording)
    T = recording.T_tracker_body.copy()
    T[:, :3, 3] *= 1e3
    task = replace(PIVOT, tolerance=1e3 * PIVOT.tolerance, limit=1e3 * PIVOT.limit,
                   systematic=1e3 * PIVOT.systematic)
    millimetres = find_fixed_point(T, recording.stamps, task)
    np.testing.assert_array_equal(millimetres.used, metres.used)
    np.testing.assert_allclose(millimetres.point, 1e3 * metres.point, rtol=1e-9)
    np.testing.assert_allclose(millimetres.covariance, 1e6 * metres.covariance, rtol=1e-6)


def test_the_same_poses_give_the_same_bits() -> None:
    recording = record(faults=PoseFaults(wrong=0.1))
    a, b = calibrated(recording), calibrated(recording)
    assert a.point.tobytes() == b.point.tobytes()
    assert a.covariance.tobytes() == b.covariance.tobytes()


def coverage(record_one: Record, find: Callable[..., FixedPoint],
             count: int = 160) -> tuple[float, float]:
    """Return how often the point is in its 95 % region, and its error is below `error`."""
    inside, below = [], []
    for seed in range(count):
        recording = record_one(np.random.default_rng(seed))
        result = find(recording.T_tracker_body, recording.stamps)
        assert result.success, result.message
        off = result.point - recording.point
        C = result.covariance[:3, :3]
        inside.append(off @ np.linalg.solve(C, off) < chi2.ppf(0.95, 3))
        below.append(np.linalg.norm(off) < result.error)
    return float(np.mean(inside)), float(np.mean(below))


@pytest.mark.parametrize('record_one, find', [
    (lambda rng: pivoting(rng, 10.0, 20.0), calibrate_pivot),
    (lambda rng: pivoting(rng, 20.0, 20.0, noise=PoseNoise(0.0002, np.radians(0.3))),
     calibrate_pivot),
    (lambda rng: pivoting(rng, 10.0, 20.0, faults=PoseFaults(wrong=0.1, dropouts=0.2)),
     calibrate_pivot),
    (lambda rng: leg_swing(rng, 40.0, 10.0, noise=PoseNoise(wander=0.001, memory=1.0)),
     find_joint_centre),
], ids=['pivot', 'noisy orientation', 'wrong readings', 'hip'])
def test_the_95_percent_region_holds(record_one: Record,
                                     find: Callable[..., FixedPoint]) -> None:
    inside, below = coverage(record_one, find)
    # 160 recordings determine a share of 0.95 to 0.017
    assert 0.91 <= inside <= 0.99
    assert 0.91 <= below <= 0.99


@pytest.mark.parametrize('share', [0.05, 0.2, 0.4])
def test_wrong_readings_are_left_out(share: float) -> None:
    recording = record(3, 20.0, faults=PoseFaults(wrong=share))
    result = calibrated(recording)
    assert error_of(result, recording) < 3e-4
    wrong = recording.kinds == PoseKind.WRONG
    assert not (result.used & wrong).any()
    assert (result.used | wrong).mean() > 0.99
    assert result.rejected['elsewhere'] + result.rejected['outlier'] >= wrong.sum()


@pytest.mark.parametrize('displacement', [0.0015, 0.003, 0.004, 0.008, 0.03])
@pytest.mark.parametrize('time', [6.0, 10.0, 14.0])
def test_the_longest_part_without_a_slip_is_used(displacement: float, time: float) -> None:
    for seed in range(5):
        recording = record(seed, 20.0, faults=PoseFaults(slips=((time, displacement),)))
        result = calibrated(recording)
        assert error_of(result, recording) < 4e-4
        before = recording.stamps < time
        assert not (before[result.used].any() and not before[result.used].all())
        assert result.used.mean() > 0.45
        said = float(result.message.split('slipped by ')[1].split(' mm')[0])
        assert said == pytest.approx(1e3 * displacement, abs=0.3)
        assert f'after {time:.1f} s' in result.message


def test_several_slips_leave_the_longest_part() -> None:
    slips = ((3.0, 0.01), (6.0, 0.01), (16.0, 0.01))
    recording = record(1, 20.0, faults=PoseFaults(slips=slips))
    result = calibrated(recording)
    assert error_of(result, recording) < 4e-4
    stamps = recording.stamps[result.used]
    assert stamps.min() == pytest.approx(6.0, abs=0.1) and stamps.max() < 16.0


def test_slips_that_leave_too_little_are_rejected() -> None:
    slips = tuple((2.0 * k, 0.01) for k in range(1, 10))
    slow = Turning(circle=20.0, opening=60.0, roll=30.0)
    result = calibrated(record(2, 20.0, turning=slow, faults=PoseFaults(slips=slips)))
    assert result.reason is PivotReason.SLIPPED and result.point is None
    assert 'slipped by' in result.message and '\n' not in result.message


def test_the_way_to_the_divot_and_back_is_left_out() -> None:
    recording = record(4, 20.0)
    T = recording.T_tracker_body.copy()
    T[:80, :3, 3] += np.linspace(0.3, 0.0, 80)[:, None]
    T[-60:, :3, 3] += np.linspace(0.0, 0.2, 60)[:, None]
    result = calibrate_pivot(T, recording.stamps)
    assert np.linalg.norm(result.point - recording.point) < 3e-4
    assert 'was not in its place for' in result.message and 'slipped' not in result.message


def rejection(result: FixedPoint) -> str:
    assert not result.success and result.point is None and result.covariance is None
    assert '\n' not in result.message
    return result.message


def test_a_tool_that_stood_still_is_rejected() -> None:
    result = calibrated(record(turning=Turning(0.0, 0.0)))
    assert result.reason is PivotReason.STOOD_STILL
    assert 'stood still, it turned by' in rejection(result)
    result = calibrated(record(turning=Turning(0.0, 0.0), noise=EXACT))
    assert result.reason is PivotReason.STOOD_STILL
    assert 'only 1 of 200 poses differ' in rejection(result)


def test_a_rotation_about_one_axis_is_rejected_with_the_axis() -> None:
    result = calibrated(record(turning=Turning(0.0, 0.6)))
    assert result.reason is PivotReason.ONE_AXIS
    assert 'only about its axis' in rejection(result) and '1.00]' in result.message


def test_a_small_range_is_rejected_with_what_is_needed() -> None:
    result = calibrated(record(turning=Turning(0.05, 0.05)))
    assert result.reason is PivotReason.RANGE_TOO_SMALL
    message = rejection(result)
    assert 'turned by 7 deg' in message and 'limit 1.0 mm' in message
    needed = float(message.split('at least ')[1].split(' deg')[0])
    enough = calibrated(record(turning=Turning(np.radians(needed / 2.0), 0.05)))
    assert enough.success


def test_a_small_range_is_rejected_even_without_noise() -> None:
    """A distorted volume looks like another tip there."""
    assert calibrated(record(noise=EXACT, turning=Turning(0.05, 0.05))).reason is (
        PivotReason.RANGE_TOO_SMALL)


def test_too_much_noise_is_rejected_by_the_expected_error() -> None:
    result = calibrated(record(0, 2.0, turning=Turning(0.25, 0.2, opening=4.0),
                               noise=PoseNoise(0.0012, 0.0)))
    assert result.reason is PivotReason.RANGE_TOO_SMALL and result.error is None
    assert 'uncertain by' in rejection(result)


def test_too_few_poses_are_rejected() -> None:
    recording = record()
    for n in (0, 1, 9):
        result = calibrate_pivot(recording.T_tracker_body[:n])
        assert result.reason is PivotReason.TOO_FEW_POSES
        assert f'only {n} of {n} poses' in rejection(result)


@pytest.mark.parametrize('seed', range(5))
def test_a_tool_waved_through_the_air_is_rejected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = record(seed, 20.0).T_tracker_body.copy()
    T[:, :3, 3] += 0.1 * np.cumsum(rng.normal(size=(len(T), 3)), axis=0) / np.sqrt(len(T))
    assert calibrate_pivot(T).reason in (PivotReason.NOT_FIXED, PivotReason.SLIPPED)


def test_random_poses_are_rejected() -> None:
    rng = np.random.default_rng(0)
    T = np.array([exp(rng.normal(size=6)) for _ in range(200)])
    assert calibrate_pivot(T).reason is PivotReason.NOT_FIXED


def test_invalid_poses_are_counted_and_the_others_used() -> None:
    recording = record(5)
    T, stamps = recording.T_tracker_body.copy(), recording.stamps.copy()
    T[3] = np.nan
    T[7, 0, 3] = np.inf
    T[11, :3, :3] *= 1.1
    T[12, :3, :3] = np.diag([1.0, 1.0, -1.0])
    T[13, :3, 3] = -3.7e28
    T[14] = 0.0
    stamps[20] = np.nan
    result = calibrate_pivot(T, stamps)
    assert error_of(result, recording) < 3e-4
    assert result.rejected['not_finite'] == 3 and result.rejected['not_rigid'] == 4
    assert not result.used[[3, 7, 11, 12, 13, 14, 20]].any()


def test_stamps_that_do_not_advance_are_no_times() -> None:
    recording = record(1, 20.0, faults=PoseFaults(slips=((14.0, 0.004),)))
    result = calibrate_pivot(recording.T_tracker_body, np.zeros(len(recording.stamps)))
    assert error_of(result, recording) < 3e-4 and 'after 280 poses' in result.message


def test_a_frozen_tracker_does_no_harm() -> None:
    recording = record(6, 20.0)
    T = np.concatenate([np.tile(recording.T_tracker_body[:1], (600, 1, 1)),
                        recording.T_tracker_body])
    result = calibrate_pivot(T)
    assert error_of(result, recording) < 4e-4 and result.rejected['repeated'] == 600


def test_a_hip_that_wanders_is_found_within_the_expected_error() -> None:
    recording = leg_swing(np.random.default_rng(0))
    result = find_joint_centre(recording.T_tracker_body, recording.stamps)
    assert 0.001 < result.error < 0.005
    assert error_of(result, recording) < result.error
    assert result.message.startswith('joint centre found')


def test_a_pelvis_that_moved_is_reported() -> None:
    recording = leg_swing(np.random.default_rng(1), faults=PoseFaults(slips=((12.0, 0.02),)))
    result = find_joint_centre(recording.T_tracker_body, recording.stamps)
    assert error_of(result, recording) < 0.006
    assert 'the joint centre moved by' in result.message


def test_shapes_are_checked() -> None:
    with pytest.raises(ValueError, match=r'\(n, 4, 4\)'):
        calibrate_pivot(np.eye(4))
    with pytest.raises(ValueError, match='need 2 stamps'):
        calibrate_pivot(np.tile(np.eye(4), (2, 1, 1)), [0.0])
