# SPDX-License-Identifier: Apache-2.0
"""The border of the zone as lines on a mesh and as pixels of a picture."""

from __future__ import annotations

import dataclasses

import numpy as np
from example_scene import example_scene
from smooth_bone import bone_field, touched_points

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.registration.confidence import error_bound
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.raycast import looking_at
from gsdf_registration.visualization.render import render
from gsdf_registration.visualization.zone_border import border_pixels, border_segments

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def test_the_border_of_a_linear_error_is_a_straight_line() -> None:
    segments = border_segments(SQUARE, HALVES, SQUARE[:, 0], 0.25)
    assert segments.shape == (2, 2, 3)
    np.testing.assert_allclose(segments[..., 0], 0.25)
    ends = np.sort(segments[..., 1], axis=1)
    np.testing.assert_allclose(ends[np.argsort(ends[:, 0])], [[0.0, 0.25], [0.25, 1.0]])


def test_there_is_no_border_on_a_bone_that_is_all_inside_or_all_outside() -> None:
    for limit in (-1.0, 2.0):
        assert border_segments(SQUARE, HALVES, SQUARE[:, 0], limit).shape == (0, 2, 3)


def test_the_border_of_a_bone_is_closed_and_at_the_limit() -> None:
    scene = example_scene(bone_field(), touched_points(10), precise=False)
    field, limit = scene.field, 0.02
    vertices = field.vertices.astype(np.float64)
    errors = error_bound(scene.T_tracker_bone, scene.covariance, vertices)
    segments = border_segments(vertices, field.faces, errors, limit)
    assert len(segments) > 20
    found = error_bound(scene.T_tracker_bone, scene.covariance, segments.reshape(-1, 3))
    np.testing.assert_allclose(found, limit, rtol=0.05)
    # each end belongs to two segments
    _, count = np.unique(np.round(segments.reshape(-1, 3), 9), axis=0, return_counts=True)
    assert (count == 2).all()


def test_pixels_on_both_sides_are_on_the_border_but_not_the_outline() -> None:
    inside, visible = np.zeros((2, 4, 5), dtype=bool)
    visible[:, :4] = True
    inside[:, :2] = True
    border = border_pixels(inside, visible)
    assert border[:, 1:3].all() and border.sum() == 8


def test_a_picture_shows_the_border() -> None:
    scene = example_scene(bone_field(), touched_points(10), precise=False)
    camera = looking_at(scene.field.surface_points.astype(np.float64), np.eye(3)[1], (120, 90),
                        margin=0.005)
    errors = error_bound(scene.T_tracker_bone, scene.covariance, scene.field.surface_points)
    limits = LimitsConfig(max_error=float(np.median(errors)))
    picture = render(dataclasses.replace(scene, limits=limits), camera).image
    dark = picture.max(axis=-1) <= max(colours.rgb(colours.BORDER))
    assert dark.sum() > 20
