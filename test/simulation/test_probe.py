# SPDX-License-Identifier: Apache-2.0
"""
Recordings are what was asked for, on the bone where they say so, and the same for the same seed.
"""

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
    Drag,
    Hand,
    Tracker,
    drag,
    measured,
    random_pose,
    rest,
)
from gsdf_registration.simulation.regions import named_patch

MIXED = Interference(uniform=0.1, soft_tissue=0.2, lift_off=0.1, other_object=0.15, resting=0.05)


@pytest.fixture(scope='module')
def cup(hip_surface: tuple[np.ndarray, np.ndarray]) -> Patch:
    return named_patch('acetabulum', *hip_surface)


def mixed(cup: Patch, seed: int = 0, **more: object) -> Drag:
    # type: ignore[arg-type]
    return drag(cup, 600, np.random.default_rng(seed), interference=MIXED, **more)


def test_samples_lie_where_their_kind_says(cup: Patch) -> None:
    run = mixed(cup)
    off = distances(run.tips, cup.corners, within=0.03)
    assert off[run.on_bone].max() < 1e-12
    tissue = off[run.kinds == Kind.SOFT_TISSUE]
    assert tissue.max() < 0.0061 and np.median(tissue) > 0.0015
    assert np.median(off[run.kinds == Kind.LIFT_OFF]) > 0.005
    low, high = cup.bounds
    strays = run.tips[run.kinds == Kind.UNIFORM]
    grown = 0.1 * (high - low)
    assert ((strays > low - grown) & (strays < high + grown)).all()
    assert ((strays < low) | (strays > high)).any()
    resting = run.tips[run.kinds == Kind.RESTING]
    assert len(np.unique(resting, axis=0)) <= 2


def test_soft_tissue_is_outward_and_smooth(cup: Patch) -> None:
    run = drag(cup, 600, np.random.default_rng(5), interference=Interference(soft_tissue=0.3))
    nearest = cup.corners.mean(axis=1)
    lifted = run.tips[run.kinds == Kind.SOFT_TISSUE]
    face = np.argmin(np.linalg.norm(lifted[:, None] - nearest, axis=2), axis=1)
    outward = ((lifted - nearest[face]) * cup.normals[face]).sum(axis=1)
    assert (outward > 0.0).mean() > 0.99
    # in patches, not scattered
    assert (np.diff(run.kinds.astype(int)) != 0).sum() < 0.1 * len(run.kinds)


def test_noise_is_as_asked(cup: Patch) -> None:
    T = random_pose(np.random.default_rng(7))
    sigma = np.array([0.3e-3, 0.5e-3, 0.7e-3])
    run = drag(cup,
               4000,
               np.random.default_rng(1),
               tracker=Tracker(sigma=tuple(sigma)),
               T_tracker_bone=T)
    error = run.positions - rigid.transform(T, run.tips)
    np.testing.assert_allclose(error.std(axis=0), sigma, rtol=0.06)
    assert np.abs(error.mean(axis=0)).max() < 0.05e-3


def test_distortion_is_smooth_and_as_large_as_asked() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform(-1.0, 1.0, (5000, 3))
    tracker = Tracker(sigma=0.0, distortion=0.002)
    bent = measured(places, tracker, np.random.default_rng(3)) - places
    assert abs(np.sqrt((bent**2).sum(axis=1).mean()) - 0.002) < 0.0002
    moved = places + [0.001, 0.0, 0.0]
    beside = measured(moved, tracker, np.random.default_rng(3)) - moved
    assert np.abs(beside - bent).max() < 0.2e-3


@settings(max_examples=25, deadline=None)
@given(shares=st.lists(st.floats(0.0, 0.18), min_size=5, max_size=5), dropouts=st.floats(0.0, 0.5),
       points=st.integers(30, 800), seed=st.integers(0, 2**32 - 1))
def test_shares_and_stamps(cup: Patch, shares: list[float], dropouts: float, points: int,
                           seed: int) -> None:
    run = drag(cup, points, np.random.default_rng(seed), interference=Interference(*shares),
               tracker=Tracker(dropouts=dropouts))
    counts = np.bincount(run.kinds, minlength=len(Kind))
    assert counts[Kind.SURFACE] == points
    np.testing.assert_allclose(counts[1:], np.array(shares) * len(run.kinds), atol=3.0)
    assert len(run.stamps) == len(run.positions) == len(run.tips) == len(run.strokes)
    assert (np.diff(run.stamps) > 0.0).all() and np.isfinite(run.positions).all()
    assert (np.diff(run.strokes) >= 0).all() and run.strokes[0] == 0


def test_outliers_prevail_if_asked(cup: Patch) -> None:
    run = drag(cup, 100, np.random.default_rng(0), interference=Interference(uniform=0.9))
    assert len(run.kinds) == 1000 and run.on_bone.sum() == 100


def test_paced_like_a_recording(cup: Patch) -> None:
    run = drag(cup,
               3000,
               np.random.default_rng(0),
               tracker=Tracker(rate=40.0, sigma=0.0, dropouts=0.05))
    gaps = np.diff(run.stamps)
    same = np.diff(run.strokes) == 0
    assert abs(np.median(gaps[same]) - 0.025) < 0.0005
    assert gaps[~same].min() > 0.5                      # a pause tells strokes apart
    assert (gaps[same] > 0.045).sum() > 20              # drop-outs
    speed = np.linalg.norm(np.diff(run.tips, axis=0), axis=1)[same] / gaps[same]
    assert 0.022 < np.median(speed) < 0.031
    assert np.percentile(speed, 99) < 0.15


def test_strokes_are_as_long_as_the_hand_makes_them(cup: Patch) -> None:
    run = drag(cup, 1000, np.random.default_rng(0), hand=Hand(stroke=0.03))
    lengths = [np.linalg.norm(np.diff(run.tips[run.strokes == k], axis=0), axis=1).sum()
               for k in range(run.strokes[-1] + 1)]
    assert 0.02 < np.median(lengths) < 0.045


def test_same_seed_same_recording(cup: Patch) -> None:
    a, b, c = mixed(cup, 4), mixed(cup, 4), mixed(cup, 5)
    for name in ('stamps', 'positions', 'tips', 'kinds', 'strokes'):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert not np.array_equal(a.tips[:10], c.tips[:10])


def test_pose_moves_points_and_nothing_else(cup: Patch) -> None:
    T = random_pose(np.random.default_rng(9))
    still, moved = (mixed(cup, 4, tracker=Tracker(sigma=0.0), T_tracker_bone=pose)
                    for pose in (None, T))
    np.testing.assert_array_equal(still.kinds, moved.kinds)
    np.testing.assert_array_equal(still.strokes, moved.strokes)
    np.testing.assert_array_equal(still.tips, moved.tips)
    np.testing.assert_allclose(rigid.transform(T, still.positions), moved.positions, atol=1e-12)


def test_landmarks_are_missed_by_little_and_held(cup: Patch) -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.05, 0.02]])
    T = random_pose(np.random.default_rng(1))
    held = rest(places,
                np.random.default_rng(2),
                tracker=Tracker(rate=40.0, sigma=0.0),
                T_tracker_bone=T)
    miss = np.linalg.norm(held.tips - places[held.strokes], axis=1)
    assert miss.min() >= 0.002 and miss.max() <= 0.004
    for k in range(3):
        own = held.stamps[held.strokes == k]
        assert 0.9 < np.ptp(own) < 1.1
        assert np.ptp(held.positions[held.strokes == k], axis=0).max() < 1e-12
    assert np.diff(held.stamps).max() > 1.5
    assert rest(np.zeros((0, 3)), np.random.default_rng(0)).positions.shape == (0, 3)


def test_random_poses() -> None:
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
def test_impossible_shares_are_refused(cup: Patch, bad: Interference) -> None:
    with pytest.raises(InputError, match='shares of interference'):
        drag(cup, 100, np.random.default_rng(0), interference=bad)
