# SPDX-License-Identifier: Apache-2.0
"""A scene with a pose, points and one next touch."""

from __future__ import annotations

import numpy as np
from smooth_bone import T_TRACKER_BONE

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.visualization.render import Scene

X = np.eye(3)[0]


def example_scene(field: Field, points: Array, precise: bool = True) -> Scene:
    """Return a scene of points (n, 3), m, bone frame, of which the last one is not used."""
    weights = np.ones(len(points))
    weights[-1:] = 0.0
    residuals, _ = field.sample(points)
    rotation_sd, translation_sd = (1e-3, 1e-4) if precise else (0.2, 1e-3)
    covariance = np.diag([translation_sd] * 3 + [rotation_sd] * 3) ** 2
    top = field.surface_points[np.argmax(field.surface_points[:, 0])].astype(np.float64)
    return Scene(field, LimitsConfig(), T_TRACKER_BONE, covariance,
                 transform(T_TRACKER_BONE, points), residuals, weights,
                 [NextTouch(top, X, 0.0008, 0.001)])
