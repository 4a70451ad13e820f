# SPDX-License-Identifier: Apache-2.0
"""At most a fixed number of points is used, and every point is accounted for."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.point_filters import filter_isolated
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.registration.pipeline import register
from gsdf_registration.registration.point_selection import (
    CHECKED,
    MAX_POINTS,
    MIN_NOISE,
    PointSelection,
    select_points,
    weights_of_all,
)

RNG = np.random.default_rng(0)
FIRST = RNG.bit_generator.state


@pytest.fixture(autouse=True)
def _same_numbers_in_any_order() -> None:
    RNG.bit_generator.state = FIRST


def plane(n: int, size: float = 0.08) -> Array:
    """Return random points (n, 3), m, of a square in z = 0 with the noise of a tracker."""
    return RNG.uniform([0.0, 0.0, 0.0], [size, size, 0.0], (n, 3)) + 2e-4 * RNG.normal(size=(n, 3))


def scattered(n: int) -> Array:
    return RNG.uniform(-0.3, 0.3, (n, 3))


def counted(selection: PointSelection) -> int:
    return len(selection.rows) + sum(selection.left_out.values())


def test_uses_all_points_on_strokes_up_to_the_limit() -> None:
    points = np.concatenate([plane(1800), scattered(150)])
    points = np.concatenate([points, points[:50]])
    selection = select_points(points, limit=2000)
    np.testing.assert_array_equal(selection.rows, np.flatnonzero(filter_isolated(points)))
    assert selection.left_out['downsampled'] == 0 and selection.left_out['repeated'] == 50
    assert selection.left_out['isolated'] > 100
    assert counted(selection) == 2000


@pytest.mark.parametrize('outliers', [0.0, 0.3, 0.9])
def test_outliers_and_points_on_strokes_keep_their_shares(outliers: float) -> None:
    n = 60_000
    points = np.concatenate([plane(round((1.0 - outliers) * n), 0.06),
                             scattered(round(outliers * n))])
    order = RNG.permutation(n)
    selection = select_points(points[order], limit=2000)
    assert counted(selection) == n
    assert len(selection.rows) <= 2000
    checked = n if n < CHECKED * 2000 else CHECKED * 2000
    assert selection.left_out['isolated'] == pytest.approx(outliers * checked, abs=0.02 * checked)
    assert np.mean(order[selection.rows] < (1.0 - outliers) * n) > 0.97


def test_points_are_spread_over_the_whole_recording() -> None:
    rows = select_points(plane(30_000), limit=1000).rows
    assert len(rows) == 1000
    assert rows[0] < 60 and rows[-1] > 29_940
    assert np.diff(rows).max() < 200


@pytest.mark.parametrize('resting', [560, 150_000])
def test_a_stationary_tip_is_one_touch(resting: int) -> None:
    strokes, place = plane(900, 0.05), np.array([0.02, 0.03, 0.003])
    clump = place + 2e-4 * RNG.normal(size=(resting, 3))
    selection = select_points(np.concatenate([strokes, clump]), limit=2000)
    assert selection.strokes > 880 and len(selection.touches) == 1
    assert np.linalg.norm(selection.positions[-1] - place) < 1e-4
    assert selection.rows[-1] >= 900 and selection.left_out['resting'] > resting - 20
    assert MIN_NOISE <= selection.touches[0] < 1.0
    assert counted(selection) == 900 + resting


def test_every_point_of_a_stroke_is_used() -> None:
    x = np.arange(0.0, 0.05, 3e-4)
    stroke = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    crossing = stroke[:, [1, 0, 2]] + [0.02, -0.02, 0.0]
    assert len(select_points(np.concatenate([stroke, crossing])).rows) == 2 * len(x)


def touches(places: Array, at_rest: int = 40, in_air: int = 12) -> Array:
    """Return the samples of a tip that rests at each place and moves through the air between."""
    parts = []
    for a, b in zip(places, np.roll(places, -1, axis=0)):
        s = np.linspace(0.0, 1.0, in_air)[:, None]
        parts += [np.repeat(a[None], at_rest, axis=0),
                  a + s * (b - a) + [0.0, 0.0, 0.03] * np.sin(np.pi * s)]
    path = np.concatenate(parts)
    return path + 1.5e-4 * RNG.normal(size=path.shape)


def scattered_places(n: int) -> Array:
    grid = 0.01 * np.array([[i, j, 0.0] for i in range(10) for j in range(10)])
    return grid[RNG.permutation(100)[:n]]


def test_each_rest_is_a_touch_in_the_place_of_the_rest() -> None:
    places = scattered_places(40)
    for mode in ('touches', 'both'):
        selection = select_points(touches(places), mode)
        attempts = list(selection.attempts(30))
        alone = attempts[0]
        assert alone.strokes == 0 and len(alone.touches) == 40
        off = np.linalg.norm(alone.positions[:, None] - places, axis=2).min(axis=0)
        assert off.max() < 1.5e-4
        np.testing.assert_allclose(alone.touches, 1.0, atol=0.3)
        assert all(counted(each) == 40 * 52 for each in attempts)


def test_points_captured_one_by_one_are_touches() -> None:
    places = scattered_places(60)
    for mode, count in (('both', 60), ('touches', 60), ('strokes', 0)):
        selection = select_points(places, mode)
        assert len(selection.touches) == count and len(selection.rows) == 60
        np.testing.assert_array_equal(selection.positions, places)


def test_in_the_mode_strokes_a_rest_does_not_count() -> None:
    selection = select_points(np.concatenate([plane(900, 0.05), touches(scattered_places(1))]),
                              'strokes')
    assert not len(selection.touches) and selection.left_out['resting'] >= 40
    assert counted(selection) == 952


def test_a_few_touches_are_used_with_the_strokes_only() -> None:
    few = select_points(np.concatenate([plane(900, 0.05), touches(scattered_places(5))]))
    assert list(few.attempts(30)) == [few]
    assert len(few.touches) == 5 and few.thinned(100).strokes == 100
    assert len(few.thinned(100).touches) == 5 and counted(few.thinned(100)) == counted(few)


def test_a_distant_outlier_does_not_change_the_selection_of_the_others() -> None:
    points = plane(5000)
    rows = select_points(points, limit=1000).rows
    far = select_points(np.concatenate([points, [[9e5, -9e5, 9e5]]]), limit=1000).rows
    assert np.isin(far, rows).mean() > 0.5 and len(far) == 1000


def test_points_that_were_not_used_get_the_weight_of_the_nearest_one() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-4], [0.02, 0.0, 0.0], [0.0201, 0.0, 0.0],
                       [0.0, 0.0, 5e-3]])
    residuals = np.array([1e-4, 2e-4, 1e-4, 1e-4, 5e-3])
    weights = weights_of_all(points, np.array([0, 2]), np.array([0.9, 0.1]), residuals)
    np.testing.assert_array_equal(weights, [0.9, 0.9, 0.1, 0.1, 0.0])


def test_registers_many_points_with_a_true_error_and_the_same_bits_every_time() -> None:
    touched = transform(T_TRACKER_BONE, np.concatenate([
        touched_points(3000, seed, 3e-4) for seed in range(15)]))
    points = np.concatenate([touched, touched.mean(axis=0) + RNG.uniform(-0.3, 0.3, (5000, 3))])
    points = points[RNG.permutation(len(points))]
    config = Config().replaced({'search.rotations': 200, 'search.places': 20, 'search.parts': 2})
    results = [register(points, bone_field(), config.replaced({'search.threads': threads}),
                        T_tracker_bone=T_TRACKER_BONE) for threads in (1, 2)]
    first, second = results
    assert first.T_tracker_bone is not None and first.weights is not None
    assert first.T_tracker_bone.tobytes() == second.T_tracker_bone.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()
    assert first.weights.tobytes() == second.weights.tobytes()
    assert first.received == first.used + sum(first.left_out.values()) == 50_000
    assert first.used == MAX_POINTS and 'downsampled' in first.message
    error = rigid.rms_displacement(inverse(first.T_tracker_bone), inverse(T_TRACKER_BONE), touched)
    assert error < 3.0 * first.predicted_tre_m['rms'] < 2e-4
    # every point has a residual, and those on the bone a weight
    assert np.isfinite(first.residuals_m).all() and len(first.weights) == 50_000
    assert (first.weights > 0.5).sum() == pytest.approx(45_000, abs=500)


@pytest.mark.parametrize('seed', range(4))
def test_a_tip_at_rest_off_the_bone_does_not_bias_the_pose(seed: int) -> None:
    rng, field = np.random.default_rng(seed), bone_field()
    stroke = touched_points(600, seed, 1.5e-4)
    place = stroke[rng.integers(len(stroke))]
    outward = field.sample(place[None])[1][0]
    resting = place + 3.5e-3 * outward + 1.5e-4 * rng.normal(size=(560, 3))
    alone = register(transform(T_TRACKER_BONE, stroke), field)
    both = register(transform(T_TRACKER_BONE, np.concatenate([stroke, resting])), field)
    assert alone.success and both.success and both.T_tracker_bone is not None
    moved = rigid.rms_displacement(alone.T_tracker_bone, both.T_tracker_bone,
                                   field.surface_points.astype(np.float64))
    assert moved < 0.5 * both.predicted_tre_m['rms']


@pytest.mark.parametrize('strokes', [0, 3000])
def test_touches_are_used_without_the_air_between_but_with_the_strokes(strokes: int) -> None:
    rng = np.random.default_rng(0)
    places = touched_points(40, 1, 1e-5)
    places = places[np.argsort(places[:, 2] + 0.3 * places[:, 0])]
    outward = bone_field().sample(places)[1]
    parts = []
    for k in range(40):
        height = 0.03 * np.sin(np.linspace(0.0, np.pi, 14)[1:-1, None])
        to = places[(k + 1) % 40]
        s = np.linspace(0.0, 1.0, 14)[1:-1, None]
        parts += [np.repeat(places[k:k + 1], 20, axis=0),
                  places[k] + s * (to - places[k]) + height * outward[k]]
    stream = np.concatenate(parts)
    stream = np.concatenate([stream + 1e-4 * rng.normal(size=stream.shape),
                             touched_points(strokes, 2, 1e-4)])
    result = register(transform(T_TRACKER_BONE, stream), bone_field(),
                      Config().replaced({'model.surface_error': 0.0}),
                      T_tracker_bone=T_TRACKER_BONE)
    assert result.success and result.T_tracker_bone is not None
    surface = bone_field().surface_points.astype(np.float64)
    error = rigid.rms_displacement(inverse(result.T_tracker_bone), inverse(T_TRACKER_BONE), surface)
    assert error < 1.5e-3
    assert result.used == 40 if not strokes else result.used > 2500
    assert result.received == result.used + sum(result.left_out.values()) == len(stream)
    assert result.weights is not None and (result.weights > 0.5).sum() > 700 + 0.8 * strokes
    assert 'points at rest count as' in result.message
