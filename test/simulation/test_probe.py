# SPDX-License-Identifier: Apache-2.0
"""Test simulated recordings: their samples, noise, timing and reproducibility."""

from __future__ import annotations

import numpy as np
import pytest
from exact import distances
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError
from gsdf_registration.simulation.interference import Interference, Kind
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import (
    Hand,
    SimulatedRecording,
    Tracker,
    measure,
    random_pose,
    simulate_landmarks,
    simulate_scan,
)
from gsdf_registration.simulation.regions import named_patch

MIXED = Interference(uniform=0.1, soft_tissue=0.2, lift_off=0.1, other_object=0.15, resting=0.05)


@pytest.fixture(scope='module')
def cup(hip_surface: tuple[np.ndarray, np.ndarray]) -> Patch:
    return named_patch('acetabulum', *hip_surface)


def with_interference(cup: Patch, seed: int = 0, **more: object) -> SimulatedRecording:
    # type: ignore[arg-type]
    return simulate_scan(cup, 600, np.random.default_rng(seed), interference=MIXED, **more)


def test_samples_of_each_kind_are_where_they_should_be(cup: Patch) -> None:
    scan = with_interference(cup)
    off = distances(scan.tips, cup.corners, within=0.03)
    assert off[scan.on_bone].max() < 1e-12
    tissue = off[scan.kinds == Kind.SOFT_TISSUE]
    assert tissue.max() < 0.0061 and np.median(tissue) > 0.0015
    assert np.median(off[scan.kinds == Kind.LIFT_OFF]) > 0.005
    low, high = cup.bounds
    outliers = scan.tips[scan.kinds == Kind.UNIFORM]
    grown = 0.1 * (high - low)
    assert ((outliers > low - grown) & (outliers < high + grown)).all()
    assert ((outliers < low) | (outliers > high)).any()
    resting = scan.tips[scan.kinds == Kind.RESTING]
    assert len(np.unique(resting, axis=0)) <= 2


def test_soft_tissue_is_outward_and_smooth(cup: Patch) -> None:
    scan = simulate_scan(cup, 600, np.random.default_rng(5),
                         interference=Interference(soft_tissue=0.3))
    nearest = cup.corners.mean(axis=1)
    lifted = scan.tips[scan.kinds == Kind.SOFT_TISSUE]
    face = np.argmin(np.linalg.norm(lifted[:, None] - nearest, axis=2), axis=1)
    outward = ((lifted - nearest[face]) * cup.normals[face]).sum(axis=1)
    assert (outward > 0.0).mean() > 0.99
    # in patches, not scattered
    assert (np.diff(scan.kinds.astype(int)) != 0).sum() < 0.1 * len(scan.kinds)


def test_noise_has_the_requested_sigma(cup: Patch) -> None:
    T = random_pose(np.random.default_rng(7))
    sigma = np.array([0.3e-3, 0.5e-3, 0.7e-3])
    scan = simulate_scan(cup,
               4000,
               np.random.default_rng(1),
               tracker=Tracker(sigma=tuple(sigma)),
               T_tracker_bone=T)
    error = scan.positions - rigid.transform(T, scan.tips)
    np.testing.assert_allclose(error.std(axis=0), sigma, rtol=0.06)
    assert np.abs(error.mean(axis=0)).max() < 0.05e-3


def test_distortion_is_smooth_and_has_the_requested_rms() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform(-1.0, 1.0, (5000, 3))
    tracker = Tracker(sigma=0.0, distortion=0.002)
    bent = measure(places, tracker, np.random.default_rng(3)) - places
    assert abs(np.sqrt((bent**2).sum(axis=1).mean()) - 0.002) < 0.0002
    moved = places + [0.001, 0.0, 0.0]
    beside = measure(moved, tracker, np.random.default_rng(3)) - moved
    assert np.abs(beside - bent).max() < 0.2e-3


@settings(max_examples=25, deadline=None)
@given(shares=st.lists(st.floats(0.0, 0.18), min_size=5, max_size=5), dropouts=st.floats(0.0, 0.5),
       points=st.integers(30, 800), seed=st.integers(0, 2**32 - 1))
def test_shares_of_interference_and_stamps(cup: Patch, shares: list[float], dropouts: float,
                                           points: int, seed: int) -> None:
    scan = simulate_scan(cup, points, np.random.default_rng(seed),
                         interference=Interference(*shares), tracker=Tracker(dropouts=dropouts))
    counts = np.bincount(scan.kinds, minlength=len(Kind))
    assert counts[Kind.SURFACE] == points
    np.testing.assert_allclose(counts[1:], np.array(shares) * len(scan.kinds), atol=3.0)
    assert len(scan.stamps) == len(scan.positions) == len(scan.tips) == len(scan.strokes)
    assert (np.diff(scan.stamps) > 0.0).all() and np.isfinite(scan.positions).all()
    assert (np.diff(scan.strokes) >= 0).all() and scan.strokes[0] == 0


def test_outliers_can_be_the_majority(cup: Patch) -> None:
    scan = simulate_scan(cup, 100, np.random.default_rng(0), interference=Interference(uniform=0.9))
    assert len(scan.kinds) == 1000 and scan.on_bone.sum() == 100


def test_samples_have_the_rate_speed_and_pauses_of_a_recording(cup: Patch) -> None:
    scan = simulate_scan(cup,
               3000,
               np.random.default_rng(0),
               tracker=Tracker(rate=40.0, sigma=0.0, dropouts=0.05))
    gaps = np.diff(scan.stamps)
    same = np.diff(scan.strokes) == 0
    assert abs(np.median(gaps[same]) - 0.025) < 0.0005
    assert gaps[~same].min() > 0.5                      # a pause separates strokes
    assert (gaps[same] > 0.045).sum() > 20              # drop-outs
    speed = np.linalg.norm(np.diff(scan.tips, axis=0), axis=1)[same] / gaps[same]
    assert 0.022 < np.median(speed) < 0.031
    assert np.percentile(speed, 99) < 0.15


def test_strokes_have_the_requested_length(cup: Patch) -> None:
    scan = simulate_scan(cup, 1000, np.random.default_rng(0), hand=Hand(stroke=0.03))
    lengths = [np.linalg.norm(np.diff(scan.tips[scan.strokes == k], axis=0), axis=1).sum()
               for k in range(scan.strokes[-1] + 1)]
    assert 0.02 < np.median(lengths) < 0.045


def test_same_seed_yields_the_same_recording(cup: Patch) -> None:
    a, b, c = with_interference(cup, 4), with_interference(cup, 4), with_interference(cup, 5)
    for name in ('stamps', 'positions', 'tips', 'kinds', 'strokes'):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert not np.array_equal(a.tips[:10], c.tips[:10])


def test_pose_changes_only_the_positions(cup: Patch) -> None:
    T = random_pose(np.random.default_rng(9))
    still, moved = (with_interference(cup, 4, tracker=Tracker(sigma=0.0), T_tracker_bone=pose)
                    for pose in (None, T))
    np.testing.assert_array_equal(still.kinds, moved.kinds)
    np.testing.assert_array_equal(still.strokes, moved.strokes)
    np.testing.assert_array_equal(still.tips, moved.tips)
    np.testing.assert_allclose(rigid.transform(T, still.positions), moved.positions, atol=1e-12)


def test_tip_is_stationary_near_each_landmark(cup: Patch) -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.05, 0.02]])
    T = random_pose(np.random.default_rng(1))
    recording = simulate_landmarks(places,
                np.random.default_rng(2),
                tracker=Tracker(rate=40.0, sigma=0.0),
                T_tracker_bone=T)
    miss = np.linalg.norm(recording.tips - places[recording.strokes], axis=1)
    assert miss.min() >= 0.002 and miss.max() <= 0.004
    for k in range(3):
        own = recording.stamps[recording.strokes == k]
        assert 0.9 < np.ptp(own) < 1.1
        assert np.ptp(recording.positions[recording.strokes == k], axis=0).max() < 1e-12
    assert np.diff(recording.stamps).max() > 1.5
    assert simulate_landmarks(np.zeros((0, 3)), np.random.default_rng(0)).positions.shape == (0, 3)


def test_random_poses_are_uniform_or_limited() -> None:
    rng = np.random.default_rng(0)
    angles = np.degrees(
        [rigid.angle_between(np.eye(3),
                             random_pose(rng)[:3, :3]) for _ in range(400)])
    assert 120.0 < angles.mean() < 132.0        # uniform over SO(3): 126.5
    for _ in range(50):
        T = random_pose(rng, angle=np.radians(45.0), translation=0.5)
        assert rigid.is_rigid(T) and np.abs(T[:3, 3]).max() <= 0.5
        assert rigid.angle_between(np.eye(3), T[:3, :3]) <= np.radians(90.0)


@pytest.mark.parametrize('bad',
                         [Interference(uniform=-0.1),
                          Interference(uniform=0.5, soft_tissue=0.5)])
def test_rejects_invalid_shares(cup: Patch, bad: Interference) -> None:
    with pytest.raises(InputError, match='shares of interference'):
        simulate_scan(cup, 100, np.random.default_rng(0), interference=bad)
