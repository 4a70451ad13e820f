# SPDX-License-Identifier: Apache-2.0
"""The motion that the points constrain least."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from smooth_bone import ball_mesh, bone_field, field_of, touched_points

from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.result import WeakestDirection
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence, assess_at
from gsdf_registration.registration.weakest_direction import weakest_direction
from gsdf_registration.solver import solve

SIGMA = 1e-4


def weakest_of(field: Field, points: Array, names: Mapping[str, Array]) -> WeakestDirection:
    """Return the weakest direction of points (n, 3), m, bone frame."""
    config = SolverConfig(method='paper')
    confidence = assess_at(solve(points, field, np.eye(4), config), points, field, 0.0)
    assert confidence is not None
    return weakest_direction(confidence, field.surface_points.astype(np.float64), points,
                             field.sample(points)[1].mean(axis=0), names)


def test_of_a_spindle_it_is_the_rotation_about_its_axis() -> None:
    spindle = ball_mesh(np.array([0.03, 0.031, 0.08]))
    points = touched_points(400, 0, SIGMA, radius=1.0, mesh=spindle)
    weakest = weakest_of(field_of(spindle), points, {})
    assert abs(weakest.axis[2]) > 0.99
    assert np.linalg.norm(np.cross(weakest.point, [0.0, 0.0, 1.0])) < 2e-3
    assert abs(weakest.pitch_m_per_rad) < 1e-3
    assert weakest.sentence.startswith(
        'least constrained: rotation about the axis through the touched area, along the long axis '
        f'of the bone (1 SD: {np.degrees(weakest.rotation_sigma_rad):.2f} deg, ')
    assert weakest.sentence.endswith(' mm where the bone is farthest from the axis)')


def test_of_a_prism_it_is_the_translation_along_it() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (500, 3)) * [0.02, 0.03, 0.07]
    normals = np.zeros((500, 3))
    normals[:250, 0], normals[250:, 1] = 1.0, 1.0
    normals[:5] = [0.0, 0.0, 1.0]                   # hardly any points on its end
    J = np.hstack([np.cross(points, normals), normals])
    confidence = Confidence(SIGMA**2 * np.linalg.inv(J.T @ J), np.zeros(3), SIGMA, 1.0)
    weakest = weakest_direction(confidence, points, points, np.zeros(3), {})
    assert abs(weakest.axis[2]) > 0.99 and weakest.pitch_m_per_rad == np.inf
    assert weakest.translation_sigma_m == pytest.approx(SIGMA / np.sqrt(5), rel=0.1)
    assert weakest.sentence == ('least constrained: translation along the long axis of the bone '
                                '(1 SD: < 0.1 mm)')


def test_landmarks_and_targets_name_the_axis() -> None:
    points = touched_points(300, 0, 5e-4)
    bare = weakest_of(bone_field(), points, {})
    names = {'elsewhere': bare.point + 0.2, 'knob': bare.point}
    named = weakest_of(bone_field(), points, names)
    assert "about the axis through 'knob', " in named.sentence and 'elsewhere' not in named.sentence
    assert 'knob' not in bare.sentence
    np.testing.assert_array_equal(named.axis, bare.axis)


def test_a_screw_with_translation_has_both_in_its_sentence() -> None:
    surface = bone_field().surface_points.astype(np.float64)
    motion = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 1e-3])
    confidence = Confidence(np.outer(motion, motion) + 1e-12 * np.eye(6), np.zeros(3), SIGMA, 1.0)
    weakest = weakest_direction(confidence, surface, touched_points(50), np.zeros(3), {})
    assert '(1 SD: 1.15 deg, 1.0 mm along the axis, ' in weakest.sentence
    assert weakest.pitch_m_per_rad == pytest.approx(0.05, rel=1e-3)
