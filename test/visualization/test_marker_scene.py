# SPDX-License-Identifier: Apache-2.0
"""The scene as markers: light in the colours of the bone."""

from __future__ import annotations

import numpy as np
import trimesh
from smooth_bone import field_of

from gsdf_registration.visualization import colours
from gsdf_registration.visualization.marker_scene import LIGHT, SHADE, MarkerScene


def test_the_bone_is_brightest_towards_the_light() -> None:
    ball = trimesh.creation.icosphere(3, 0.02)
    bone, = (marker for marker in MarkerScene().bone(field_of(ball, 0.002))
             if marker.ns == 'bone')
    outward = bone.points / np.linalg.norm(bone.points, axis=1)[:, None]
    brightness = bone.colours[:, :3] / colours.rgb(colours.ERROR[0])
    np.testing.assert_allclose(brightness, brightness[:, :1].repeat(3, axis=1), atol=1e-6)
    np.testing.assert_allclose(brightness[:, 0], SHADE + (1.0 - SHADE) * 0.5 * (
        1.0 + outward @ LIGHT), atol=0.02)
    assert np.linalg.norm(LIGHT) < 1.01 and brightness.max() < 1.01
