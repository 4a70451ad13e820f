# SPDX-License-Identifier: Apache-2.0
"""The rendered bone, points and next touches."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from example_scene import X, example_scene
from pixel_colours import has_colour
from smooth_bone import bone_field, touched_points

from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.raycast import looking_at
from gsdf_registration.visualization.render import Scene, View, render

SHAPE = (120, 90)


def view_from(direction: Array, scene: Scene) -> View:
    surface = scene.field.surface_points.astype(np.float64)
    return render(scene, looking_at(surface, direction, SHAPE, margin=0.005))


def test_points_are_visible_from_their_side_only() -> None:
    scene = example_scene(bone_field(), touched_points(100, radius=0.02))
    blue = colours.RESIDUAL[0]
    assert has_colour(view_from(X, scene).image, blue).sum() > 50
    assert has_colour(view_from(-X, scene).image, blue).sum() == 0


def test_the_next_touch_is_green_at_its_place() -> None:
    scene = example_scene(bone_field(), touched_points(100, seed=1, radius=0.02)[:2])
    front, back = view_from(X, scene), view_from(-X, scene)
    touch, = scene.next_touches
    green = np.argwhere(has_colour(front.image, colours.NEXT))
    column, row, _ = front.camera.project(touch.position[None])
    assert len(green) > 20
    assert green.mean(axis=0) == pytest.approx([row[0], column[0]], abs=6)
    assert front.sees(touch) and not back.sees(touch)


def test_the_bone_is_purple_where_the_expected_error_is_large() -> None:
    points = touched_points(100, radius=0.02)
    precise, imprecise = (view_from(-X, example_scene(bone_field(), points, precise))
                          for precise in (True, False))
    purple = colours.ERROR[-1]
    assert has_colour(imprecise.image, purple).sum() > 500
    assert has_colour(precise.image, purple).sum() == 0


def test_without_a_pose_no_points_are_drawn() -> None:
    scene = example_scene(bone_field(), touched_points(100, radius=0.02))
    scene = dataclasses.replace(scene, T_tracker_bone=None, covariance=None)
    assert len(scene.points) == 0
    assert has_colour(view_from(X, scene).image, colours.RESIDUAL[0]).sum() == 0
