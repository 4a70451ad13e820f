# SPDX-License-Identifier: Apache-2.0
"""The likelihood of a pose given where the probe was in the air."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.free_space import (
    MOST,
    MOST_PLACES,
    PLACE,
    WRONG,
    blocked,
    log_likelihood,
    places,
    start_poses,
)
from gsdf_registration.registration.pipeline import register

T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)
SEEDS = st.integers(0, 2**32 - 1)


def around(seed: int, count: int = 40) -> Array:
    """Return positions in and around the bone, tracker frame."""
    box = np.random.default_rng(seed).uniform(-0.08, 0.08, (count, 3))
    return rigid.transform(T_TRACKER_BONE, box)


def at_depth(depth: float, count: int) -> Array:
    """Return positions at this depth inside the bone, tracker frame."""
    field = bone_field()
    rows = np.linspace(0, len(field.surface_points) - 1, count).astype(int)
    inside = field.surface_points[rows] - depth * field.surface_normals[rows]
    return rigid.transform(T_TRACKER_BONE, inside.astype(np.float64))


@given(SEEDS, SEEDS)
@settings(deadline=None, max_examples=30)
def test_more_places_never_make_a_pose_more_likely(seed: int, more: int) -> None:
    air = around(seed)
    extended = np.concatenate([air, around(more, 5)])
    assert (log_likelihood(extended, T_BONE_TRACKER, bone_field())
            <= log_likelihood(air, T_BONE_TRACKER, bone_field()) + 1e-12)


def test_a_deeper_place_never_makes_a_pose_more_likely() -> None:
    found = [log_likelihood(at_depth(depth, 1), T_BONE_TRACKER, bone_field())
             for depth in np.linspace(-0.02, 0.02, 81)]
    assert (np.diff(found) <= 1e-9).all()
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found[-1] == pytest.approx(np.log(WRONG), abs=1e-3)


@given(SEEDS, SEEDS)
@settings(deadline=None, max_examples=30)
def test_a_motion_of_the_tracker_changes_nothing(seed: int, motion: int) -> None:
    air = around(seed)
    T = rigid.exp(np.random.default_rng(motion).normal(size=6))
    assert log_likelihood(rigid.transform(T, air), T_BONE_TRACKER @ rigid.inverse(T),
                          bone_field()) == pytest.approx(
        log_likelihood(air, T_BONE_TRACKER, bone_field()), abs=1e-4)


@given(SEEDS, SEEDS)
@settings(deadline=None, max_examples=30)
def test_the_order_of_the_positions_changes_nothing(seed: int, order: int) -> None:
    air = around(seed, 200)
    shuffled = np.random.default_rng(order).permutation(air)
    np.testing.assert_array_equal(places(shuffled), places(air))


def test_a_probe_that_stays_in_a_place_counts_once() -> None:
    corner = np.floor(at_depth(0.01, 1) / PLACE) * PLACE
    cloud = corner + PLACE * np.random.default_rng(0).uniform(0.1, 0.9, (500, 3))
    assert len(places(cloud)) == 1


def test_a_place_on_the_surface_costs_almost_nothing() -> None:
    surface = at_depth(0.0, 30)
    assert -1.0 < log_likelihood(surface, T_BONE_TRACKER, bone_field()) < 0.0


def test_the_air_costs_a_limited_amount_however_much_is_inside() -> None:
    few, many = at_depth(0.01, 12), at_depth(0.01, 3000)
    assert log_likelihood(few, T_BONE_TRACKER, bone_field()) == pytest.approx(
        12.0 * np.log(WRONG), rel=1e-2)
    assert log_likelihood(many, T_BONE_TRACKER, bone_field()) == -MOST


def test_blocked_places_are_counted() -> None:
    air = np.concatenate([at_depth(0.008, 5), at_depth(0.001, 7), at_depth(-0.02, 11)])
    found = blocked(air, T_BONE_TRACKER, bone_field())
    assert (found.places, found.total) == (5, 23)
    assert found.depth == pytest.approx(0.008, abs=5e-4)


def test_without_air_the_evidence_is_exactly_zero() -> None:
    assert Evidence().log_likelihood(T_BONE_TRACKER, bone_field()) == 0.0


def test_the_number_of_places_is_limited() -> None:
    grid = np.stack(np.meshgrid(*3 * [np.arange(30)]), axis=-1).reshape(-1, 3)
    assert 0.5 * MOST_PLACES < len(places(PLACE * (grid + 0.5))) <= MOST_PLACES


@pytest.mark.parametrize('air', [[1.0, 2.0, 3.0], [[1.0, 2.0]], [[np.nan, 0.0, 0.0]],
                                 [[1e9, 0.0, 0.0]]])
def test_positions_that_are_none_are_an_error(air: list[float]) -> None:
    with pytest.raises(InputError, match='positions in the air must be rows of three finite'):
        places(air)


def test_poses_that_the_air_rules_out_leave_as_many_others_to_start_from() -> None:
    air = at_depth(-0.003, 200)
    inward = [rigid.from_rt(np.eye(3), [0.01 * k, 0.0, 0.0]) @ T_BONE_TRACKER for k in range(1, 5)]
    away = [rigid.from_rt(np.eye(3), [1.0 + k, 0.0, 0.0]) @ T_BONE_TRACKER for k in range(4)]
    found = np.array([*inward, *away])
    chosen = start_poses(found, air, bone_field(), 3)
    np.testing.assert_array_equal(chosen, found[[0, 1, 2, 4, 5, 6]])
    np.testing.assert_array_equal(start_poses(found, air[:0], bone_field(), 3), found[:3])
    np.testing.assert_array_equal(start_poses(found[:1], air, bone_field(), 3), found[:1])


def test_air_does_not_change_a_pose_without_doubt_but_is_remarked() -> None:
    points = rigid.transform(T_TRACKER_BONE, touched_points(400, 0, 3e-4))
    config = Config.from_flat({'search.rotations': 40})
    without = register(points, bone_field(), config)
    for depth, remarked in ((-0.004, False), (0.01, True)):
        found = register(points, bone_field(), config, air=at_depth(depth, 300))
        assert found.success
        np.testing.assert_array_equal(found.T_tracker_bone, without.T_tracker_bone)
        assert ('the probe has been where the bone would be' in found.message) == remarked


def test_air_that_is_no_positions_is_refused_with_one_sentence() -> None:
    result = register(touched_points(400), bone_field(), air=[[1.0, 2.0]])
    assert result.reason is Reason.BAD_INPUT
    assert result.message.startswith('positions in the air must be rows of three finite numbers')
