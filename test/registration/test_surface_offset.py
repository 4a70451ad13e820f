# SPDX-License-Identifier: Apache-2.0
"""Test that points of a ball tip with another radius than in the settings are explained."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array, exp, inverse, rms_displacement, transform
from gsdf_registration.field import Field, build_field
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.registration.pipeline import register
from gsdf_registration.registration.surface_offset import SurfaceOffset
from gsdf_registration.simulation.ball_tip import with_ball_tip
from gsdf_registration.simulation.probe import Tracker, simulate_scan
from gsdf_registration.simulation.regions import named_patch
from gsdf_registration.simulation.surface_errors import displaced

T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])


@pytest.fixture(scope='module')
def hip(hip_surface: tuple[Array, np.ndarray]) -> Field:
    return build_field(make_bone(*hip_surface, None), 0.001)


@pytest.fixture(scope='module')
def centres(hip_surface: tuple[Array, np.ndarray]) -> Array:
    """Return measured centres (n, 3) of a ball of 1 mm radius in the cup, tracker frame."""
    patch = named_patch('acetabulum', *hip_surface)
    sharp = simulate_scan(patch, 600, np.random.default_rng(0), tracker=Tracker(sigma=3e-4),
                          T_tracker_bone=T_TRACKER_BONE)
    return with_ball_tip(sharp, *hip_surface, patch.approach, 0.001).positions


def registered(centres: Array, hip: Field, radius: float,
               start: Array = T_TRACKER_BONE) -> RegistrationResult:
    config = Config().replaced({'probe.tip_radius': radius, 'collect.mode': 'strokes',
                                'model.surface_error': 0.0})
    return register(centres, hip, config, T_tracker_bone=start)


def test_the_right_radius_gives_the_pose_without_a_remark(centres: Array, hip: Field) -> None:
    result = registered(centres, hip, 0.001)
    assert result.T_tracker_bone is not None and 'probe.tip_radius' not in result.message
    error = rms_displacement(result.T_tracker_bone @ inverse(T_TRACKER_BONE), np.eye(4),
                             transform(T_TRACKER_BONE, hip.surface_points))
    assert error < 4e-4


@pytest.mark.parametrize('radius, words', [
    (0.0, 'the points lie 1.0 mm outside the bone on average: check probe.tip_radius and the tip, '
          'or is it cartilage?'),
    (0.002, 'the points lie 1.0 mm inside the bone on average: check probe.tip_radius and the '
            'tip')])
def test_a_wrong_radius_is_named_as_the_cause(centres: Array, hip: Field, radius: float,
                                              words: str) -> None:
    result = registered(centres, hip, radius)
    assert words in result.message
    assert result.success or result.reason is Reason.MODEL_MISMATCH
    assert 'patient' not in result.message


def test_the_result_moves_with_the_points(centres: Array, hip: Field) -> None:
    T = exp([0.5, 0.2, -0.4, -0.3, 0.6, 0.1])
    first = registered(centres, hip, 0.001)
    second = registered(transform(T, centres), hip, 0.001, T @ T_TRACKER_BONE)
    assert first.T_tracker_bone is not None and second.T_tracker_bone is not None
    np.testing.assert_allclose(second.T_tracker_bone, T @ first.T_tracker_bone, atol=1e-5)


def test_points_inside_are_not_cartilage() -> None:
    assert 'cartilage' in SurfaceOffset(0.001, 1e-5).sentence
    assert 'cartilage' not in SurfaceOffset(-0.001, 1e-5).sentence


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_model_that_is_eroded_everywhere_is_no_other_bone(
        hip: Field, hip_surface: tuple[Array, np.ndarray], seed: int) -> None:
    """An offset within the expected error of the model is estimated with the pose."""
    patch = named_patch('acetabulum', *hip_surface)
    scan = simulate_scan(patch, 800, np.random.default_rng(seed), tracker=Tracker(sigma=1.5e-4),
                         T_tracker_bone=T_TRACKER_BONE)
    scan = displaced(scan, 3e-4 * hip.sample(scan.tips)[1])
    result = register(scan.positions, hip, Config(), T_tracker_bone=T_TRACKER_BONE)
    assert result.reason is Reason.CONVERGED and result.T_tracker_bone is not None
    touched = transform(T_TRACKER_BONE, patch.corners.mean(axis=1))
    assert rms_displacement(result.T_tracker_bone @ inverse(T_TRACKER_BONE), np.eye(4),
                            touched) < 1e-4
