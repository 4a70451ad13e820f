# SPDX-License-Identifier: Apache-2.0
"""The camera and the ray casting."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import bone_field

from gsdf_registration.visualization.raycast import cast, light, looking_at

SHAPE = (120, 90)


@pytest.mark.parametrize('direction', [[1.0, 0.2, 0.1], [0.0, 0.0, 1.0], [-0.3, -1.0, 0.5]])
def test_rays_hit_the_bone_and_miss_only_beside_it(direction: list[float]) -> None:
    field = bone_field()
    surface = field.surface_points.astype(np.float64)
    camera = looking_at(surface, np.array(direction), SHAPE, margin=0.005)
    visible, places = cast(field, camera)
    assert np.abs(field.sample(places)[0]).max() < 1e-4
    columns, rows, _ = camera.project(places)
    assert (np.floor(rows) * SHAPE[1] + np.floor(columns)).astype(int).tolist() == visible.tolist()
    missed = np.setdiff1d(np.arange(SHAPE[0] * SHAPE[1]), visible)
    on_ray = camera.pixels()[missed][:, None] + np.linspace(-0.1, 0.1, 100)[:, None] * (
        camera.axes[2])
    assert field.sample(on_ray.reshape(-1, 3))[0].min() > -1e-4
    brightness, normals = light(field, places, camera)
    assert brightness.min() > 0.1 and brightness.max() <= 1.0
    assert (normals @ camera.axes[2]).min() > -0.1      # no back faces


def test_front_view_has_x_to_the_right_and_z_up() -> None:
    camera = looking_at(np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]]), -np.eye(3)[1], SHAPE)
    columns, rows, heights = camera.project(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.02]]))
    assert (columns[0], rows[0]) == pytest.approx((0.5 * SHAPE[1], 0.5 * SHAPE[0]))
    assert columns[1] > columns[0] and rows[1] < rows[0]
    assert heights == pytest.approx(0.0)
