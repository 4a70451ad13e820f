# SPDX-License-Identifier: Apache-2.0
"""Simulated pivot recordings and leg swings have the requested motion, noise and faults."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.rigid import Array, is_rigid
from gsdf_registration.simulation.pivoting import (
    HIP_CENTRE,
    PivotRecording,
    PoseFaults,
    PoseKind,
    PoseNoise,
    Turning,
    leg_swing,
    pivoting,
)

EXACT = PoseNoise(0.0, 0.0)


def record(seed: int = 0, seconds: float = 20.0, **options: object) -> PivotRecording:
    return pivoting(np.random.default_rng(seed), seconds, 20.0, **options)


def places(recording: PivotRecording) -> Array:
    """Return where the point was at each pose, as measured (n, 3)."""
    T = recording.T_tracker_body
    return T[:, :3, :3] @ recording.point + T[:, :3, 3]


def test_without_noise_the_point_stays_exactly_in_its_place() -> None:
    recording = record(noise=EXACT)
    assert all(is_rigid(T, 1e-9) for T in recording.T_tracker_body)
    np.testing.assert_allclose(places(recording), np.tile(recording.centre, (400, 1)), atol=1e-12)


def test_the_tool_tilts_by_the_requested_angle() -> None:
    recording = record(noise=EXACT, turning=Turning(np.radians(25.0), 0.0), seconds=60.0)
    axes = recording.T_tracker_body[:, :3, 2]
    widest = np.degrees(np.arccos((axes @ axes.T).min()))
    assert widest == pytest.approx(50.0, abs=2.0)


def test_the_position_has_the_requested_noise() -> None:
    off = places(record(seconds=100.0, noise=PoseNoise(0.0003, 0.0))) - record().centre
    np.testing.assert_allclose(off.std(axis=0), 0.0003, rtol=0.1)


def test_noise_of_the_orientation_acts_across_the_lever_arm() -> None:
    recording = record(seconds=100.0, noise=PoseNoise(0.0, np.radians(0.2)))
    off = np.einsum('nij,ni->nj', recording.T_tracker_body[:, :3, :3],
                    places(recording) - recording.centre)
    arm = np.linalg.norm(recording.point)
    along = off @ recording.point / arm
    assert along.std() < 1e-5
    across = np.sqrt(((off**2).sum(axis=1) - along**2).mean() / 2.0)
    assert across == pytest.approx(np.radians(0.2) * arm, rel=0.1)


def test_the_centre_of_the_hip_moves_slowly() -> None:
    recording = leg_swing(np.random.default_rng(0), 200.0, 20.0,
                          noise=PoseNoise(0.0, 0.0, wander=0.0015, memory=0.5))
    off = places(recording) - recording.centre
    np.testing.assert_allclose(off.std(axis=0), 0.0015, rtol=0.25)
    # correlation after 0.5 s is 1/e
    shifted = (off[10:] * off[:-10]).sum() / (off**2).sum()
    assert shifted == pytest.approx(np.exp(-1.0), abs=0.1)
    np.testing.assert_array_equal(recording.point, HIP_CENTRE)


def test_slips_displace_the_point_and_are_labelled() -> None:
    recording = record(noise=EXACT, faults=PoseFaults(slips=((5.0, 0.003), (12.0, 0.008))))
    moved = np.linalg.norm(np.diff(places(recording), axis=0), axis=1)
    np.testing.assert_array_equal(recording.stamps[1:][moved > 1e-6], [5.0, 12.0])
    np.testing.assert_allclose(moved[moved > 1e-6], [0.003, 0.008])
    np.testing.assert_array_equal(recording.kinds == PoseKind.SLIPPED, recording.stamps >= 5.0)
    np.testing.assert_allclose(places(recording), recording.centres, atol=1e-12)


def test_dropouts_and_wrong_readings_have_their_shares() -> None:
    recording = record(seconds=100.0, faults=PoseFaults(dropouts=0.2, wrong=0.1))
    assert len(recording.stamps) == pytest.approx(1600, abs=6)
    assert (np.diff(recording.stamps) > 0.0).all()
    wrong = recording.kinds == PoseKind.WRONG
    assert wrong.mean() == pytest.approx(0.1, abs=0.02)
    off = np.linalg.norm(places(recording) - recording.centre, axis=1)
    assert np.median(off[wrong]) > 0.05 and off[~wrong].max() < 0.003


def test_the_same_seed_gives_the_same_recording() -> None:
    faults = PoseFaults(((3.0, 0.01),), 0.1, 0.1)
    a, b, other = (record(seed, faults=faults) for seed in (1, 1, 2))
    assert a.T_tracker_body.tobytes() == b.T_tracker_body.tobytes()
    assert a.T_tracker_body.tobytes() != other.T_tracker_body.tobytes()
