# SPDX-License-Identifier: Apache-2.0
"""Touches of a bone that deviates from its model, or with a wrong tip calibration."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common import rigid
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.probe import SimulatedRecording, random_pose
from gsdf_registration.simulation.surface_errors import (
    CARTILAGE,
    COVERED,
    cartilage,
    displaced,
    smooth_error,
    tip_error,
)


def test_a_smooth_error_has_the_given_size_and_length() -> None:
    places = np.random.default_rng(0).uniform(0.0, 0.1, (1000, 3))
    beside = places + [0.015, 0.0, 0.0]
    both = [smooth_error(np.concatenate([places, beside]), 3e-4, 0.015, np.random.default_rng(k))
            for k in range(20)]
    assert np.std(both) == pytest.approx(3e-4, rel=0.1)
    correlation = np.mean([a[:1000] @ a[1000:] / 1000 for a in both]) / 3e-4**2
    assert correlation == pytest.approx(np.exp(-0.5), abs=0.1)


def test_cartilage_covers_a_part_of_the_area_and_its_edge_is_smooth() -> None:
    x, y = np.meshgrid(np.linspace(0.0, 0.06, 80), np.linspace(0.0, 0.06, 80))
    places = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    for seed in range(10):
        thickness = cartilage(places, np.random.default_rng(seed))
        assert COVERED[0] - 0.01 < (thickness > 0.0).mean() < COVERED[1] + 0.01
        assert thickness.max() == pytest.approx(CARTILAGE)
        assert np.abs(np.diff(thickness.reshape(x.shape), axis=0)).max() < 2e-4


def test_a_tip_error_has_one_length_and_turns_with_the_tool() -> None:
    errors = tip_error(500, 5e-4, np.array([0.0, 0.0, 1.0]), np.random.default_rng(0))
    assert np.linalg.norm(errors, axis=1) == pytest.approx(5e-4)
    angles = np.degrees(np.arccos(np.clip(errors @ errors.mean(axis=0)
                                          / np.linalg.norm(errors.mean(axis=0)) / 5e-4, -1, 1)))
    assert 5.0 < np.median(angles) < 60.0


def test_a_displacement_moves_tips_and_positions_alike() -> None:
    rng = np.random.default_rng(0)
    tips, T = rng.normal(size=(5, 3)), random_pose(rng)
    recording = SimulatedRecording(np.arange(5.0), rigid.transform(T, tips), tips,
                                   np.full(5, Kind.SURFACE, np.uint8), np.zeros(5, np.int32), T)
    moved = displaced(recording, rng.normal(size=(5, 3)))
    assert moved.positions == pytest.approx(rigid.transform(T, moved.tips))
    assert np.abs(moved.tips - tips).max() > 0.1
