# SPDX-License-Identifier: Apache-2.0
"""Render the scene of ~/markers: the bone with its expected error, the points, the next touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as item
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import error_bound
from gsdf_registration.registration.guidance import PATCH
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.raycast import Camera, cast, light
from gsdf_registration.visualization.zone_border import border_pixels

POINT = 0.0012      # m, radius of a point
RIM = 0.0012        # m, of a patch


@dataclass(frozen=True, eq=False)
class Scene:
    """
    The contents of a picture.

    field : of the bone, for the tip of the probe
    limits : scales of the colours
    T_tracker_bone, covariance : (4, 4), (6, 6) float, of the pose; without it no points are drawn
    positions : (n, 3) float, m, tracker frame
    residuals, weights : (n,) float, of the points
    next_touches : of NextTouch, best first
    """

    field: Field
    limits: LimitsConfig
    T_tracker_bone: Array | None = None
    covariance: Array | None = None
    positions: Array = item(default_factory=lambda: np.zeros((0, 3)))
    residuals: Array = item(default_factory=lambda: np.zeros(0))
    weights: Array = item(default_factory=lambda: np.zeros(0))
    next_touches: Sequence[NextTouch] = ()

    @property
    def points(self) -> Array:
        """Where the tip touches the bone (n, 3), m, bone frame; none without a pose."""
        if self.T_tracker_bone is None:
            return np.zeros((0, 3))
        return self.field.contacts_at(self.T_tracker_bone, self.positions)


@dataclass(frozen=True, eq=False)
class View:
    """
    A rendered picture.

    image : (h, w, 3) float in [0, 1]
    height : (h, w) float, m, of the visible surface towards the viewer; -inf: background
    """

    camera: Camera
    image: Array
    height: Array

    def sees(self, touch: NextTouch) -> bool:
        """Return whether a patch is in the picture, faces the viewer and is not occluded."""
        column, row, height = (float(value[0])
                               for value in self.camera.project(touch.position[None]))
        rows, columns = self.height.shape
        return bool(0 <= row < rows and 0 <= column < columns
                    and touch.normal @ self.camera.axes[2] > 0.1
                    and self.height[int(row), int(column)] < height + PATCH)


def render(scene: Scene, camera: Camera) -> View:
    """Return the view of a scene by a camera."""
    rows, columns = camera.shape
    image, height = np.ones((rows * columns, 3)), np.full(rows * columns, -np.inf)
    bone = scene.field.for_tip(0.0)
    visible, places = cast(bone, camera)
    brightness, normals = light(bone, places, camera)
    colour = _bone_colours(scene, places, visible, camera)
    _blend_patches(colour, places, normals, scene.next_touches)
    image[visible] = colour * brightness[:, None]
    height[visible] = camera.project(places)[2]
    if scene.T_tracker_bone is not None:
        _draw_points(image, height, camera, scene.points, colours.residual_colours(
            scene.residuals, scene.weights, scene.limits))
    return View(camera, image.reshape(rows, columns, 3), height.reshape(rows, columns))


def _bone_colours(scene: Scene, places: Array, visible: NDArray[Any], camera: Camera) -> Array:
    """Return the colours of places on the bone by their error, with the border of the zone."""
    if scene.T_tracker_bone is None or scene.covariance is None:
        return np.tile(colours.rgb(colours.ERROR[0]), (len(places), 1))
    error = error_bound(scene.T_tracker_bone, scene.covariance, places)
    colour = colours.error_colours(error, scene.limits)
    shown, inside = np.zeros((2, camera.shape[0] * camera.shape[1]), dtype=bool)
    shown[visible], inside[visible] = True, error <= scene.limits.max_error
    border = border_pixels(inside.reshape(camera.shape), shown.reshape(camera.shape))
    colour[border.ravel()[visible]] = colours.rgb(colours.BORDER)
    return colour


def _blend_patches(colour: Array, places: Array, normals: Array,
                   touches: Sequence[NextTouch]) -> None:
    """Blend the patches to touch next into the colours of the bone, in place."""
    for touch in touches:
        distance = np.linalg.norm(places - touch.position, axis=1)
        inside = (distance < PATCH) & (normals @ touch.normal > 0.0)
        strength = np.where(distance > PATCH - RIM, 1.0, 0.55)[inside, None]
        colour[inside] += strength * (colours.rgb(colours.NEXT) - colour[inside])


def _draw_points(image: Array, height: Array, camera: Camera, points: Array,
                 colour: Array) -> None:
    """
    Draw ``points`` (n, 3) as balls of the colours (n, 3) where they are not occluded.

    The loop is over the pixels of a ball, for all balls at once. Where balls overlap, the nearest
    is drawn last.
    """
    column, row, centre = camera.project(points)
    order = np.argsort(centre)
    column, row, centre, colour = column[order], row[order], centre[order], colour[order]
    rows, columns = camera.shape
    radius = POINT / camera.pixel
    reach = int(np.ceil(radius))
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            x, y = np.floor(column) + right, np.floor(row) + down
            offset = np.hypot(x + 0.5 - column, y + 0.5 - row) / radius
            bulge = np.sqrt(np.clip(1.0 - offset**2, 0.0, 1.0))
            drawn = np.flatnonzero(
                (offset < 1.0) & (x >= 0) & (x < columns) & (y >= 0) & (y < rows))
            pixel = (y[drawn] * columns + x[drawn]).astype(np.intp)
            top = centre[drawn] + POINT * bulge[drawn]
            free = top > height[pixel]
            drawn, pixel = drawn[free], pixel[free]
            image[pixel] = colour[drawn] * (0.55 + 0.45 * bulge[drawn, None])
            height[pixel] = top[free]
