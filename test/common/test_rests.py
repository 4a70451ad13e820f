# SPDX-License-Identifier: Apache-2.0
"""Where the tip stayed in one place, from the order of the positions alone."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common import rigid
from gsdf_registration.common.rests import TRACKER_ERROR, find_rests
from gsdf_registration.common.rigid import Array

MOTION = rigid.exp([0.7, -1.9, 0.4, 0.3, -0.8, 0.2])


def drag(rng: np.random.Generator, n: int, step: float = 3.4e-4) -> Array:
    """Return ``n`` positions of a tip that moves in a curve at an unsteady speed, m."""
    way = np.cumsum(step * np.exp(0.4 * np.sin(0.3 * np.arange(n))))
    angle = way / 0.02
    return 0.02 * np.column_stack([np.sin(angle), np.cos(angle), 0.1 * angle])


@pytest.mark.parametrize('sigma', [1.5e-4, 5e-4])
@pytest.mark.parametrize('per_second', [20, 80, 1000])
def test_a_drag_has_no_rests_at_any_rate(sigma: float, per_second: int) -> None:
    rng = np.random.default_rng(0)
    points = drag(rng, 10 * per_second, 0.027 / per_second)
    rests = find_rests(points + sigma * rng.normal(size=points.shape))
    assert not len(rests.positions) and (rests.which == -1).all()


@pytest.mark.parametrize('share', [0.2, 0.35, 0.45])
def test_outliers_make_no_rest_of_a_slow_drag(share: float) -> None:
    rng = np.random.default_rng(5)
    points = drag(rng, 20_000, 7e-6) + 1.5e-4 * rng.normal(size=(20_000, 3))
    outliers = rng.random(20_000) < share
    points[outliers] = rng.uniform(-0.2, 0.2, (outliers.sum(), 3))
    assert (find_rests(points).which >= 0).mean() < 0.05


@pytest.mark.parametrize('sigma', [1.5e-4, 5e-4])
def test_a_rest_within_a_drag_is_found_with_its_place_and_noise(sigma: float) -> None:
    rng = np.random.default_rng(1)
    points = drag(rng, 600)
    points = np.insert(points, 300, np.repeat(points[300][None], 200, axis=0), axis=0)
    noisy = points + sigma * rng.normal(size=points.shape)
    rests = find_rests(noisy)
    assert len(rests.positions) == 1
    assert (rests.which[300:500] == 0).mean() > 0.99
    assert (rests.which >= 0).sum() < 220
    assert np.linalg.norm(rests.positions[0] - points[400]) < 3.0 * rests.noise[0]
    assert rests.spread[0] == pytest.approx(sigma, rel=0.25)
    assert TRACKER_ERROR <= rests.noise[0] < 3.0 * TRACKER_ERROR
    moved = find_rests(rigid.transform(MOTION, noisy))
    np.testing.assert_array_equal(moved.which, rests.which)
    np.testing.assert_allclose(moved.positions, rigid.transform(MOTION, rests.positions),
                               atol=1e-9)


def test_a_rest_with_outliers_or_beside_another_probe_is_one_rest() -> None:
    rng = np.random.default_rng(2)
    rest = 1.5e-4 * rng.normal(size=(300, 3))
    outliers = np.insert(rest, rng.integers(0, 300, 60), rng.uniform(-0.2, 0.2, (60, 3)), axis=0)
    assert np.bincount(find_rests(outliers).which + 1)[1:].tolist() == [300]
    both = np.stack([rest, 0.1 + drag(rng, 300)], axis=1).reshape(-1, 3)
    assert np.bincount(find_rests(both).which + 1)[1:].tolist() == [300]


def test_a_rest_that_drifts_states_more_noise() -> None:
    rng = np.random.default_rng(3)
    rest = 1.5e-4 * rng.normal(size=(200, 3))
    drift = np.linspace(-4e-4, 4e-4, 200)[:, None] * [1.0, 0.0, 0.0]
    steady, drifting = find_rests(rest), find_rests(rest + drift)
    assert drifting.noise[0] > 1.3 * steady.noise[0]


def test_touching_the_same_place_again_is_one_touch() -> None:
    rng = np.random.default_rng(4)
    rest = 1.5e-4 * rng.normal(size=(100, 3))
    away = np.array([0.0, 0.0, 0.05]) * np.sin(np.linspace(0.0, np.pi, 40))[:, None]
    assert len(find_rests(np.concatenate([rest, away, rest])).positions) == 1


@pytest.mark.parametrize('n', [0, 1, 2, 3, 6])
def test_a_few_positions_far_apart_are_no_rest(n: int) -> None:
    assert not len(find_rests(np.random.default_rng(n).uniform(-0.1, 0.1, (n, 3))).positions)
