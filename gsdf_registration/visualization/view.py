# SPDX-License-Identifier: Apache-2.0
"""The scene of ~/markers seen by one camera: bone, error to expect, points, where to touch next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.result import Touch
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.field import Field
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.registration.confidence import predicted_tre
from gsdf_registration.registration.guidance import PATCH
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.raycast import Camera, cast, light

POINT = 0.0012      # m, radius of a touched point
RIM = 0.0012        # m, of a patch


@dataclass(frozen=True, eq=False)
class Scene:
    """
    What there is to see.

    found : FullAssessment of the points; without a pose the bone is seen without them
    field : of the bone
    limits : what the colours are scaled by
    """

    found: FullAssessment
    field: Field
    limits: LimitsConfig

    @property
    def positions(self) -> Array:
        """The points touched, (n, 3), m, bone frame."""
        if self.found.T_tracker_bone is None:
            return np.zeros((0, 3))
        return transform(inverse(self.found.T_tracker_bone), self.found.points.positions)


@dataclass(frozen=True, eq=False)
class View:
    """
    A picture and what it takes to write on it.

    image : (h, w, 3) float in [0, 1]
    height : (h, w) float, m, of what is seen, towards the viewer; -inf: nothing
    """

    camera: Camera
    image: Array
    height: Array

    def sees(self, touch: Touch) -> bool:
        """Whether a patch is in the picture, faces us, and nothing is before it."""
        column, row, height = (float(value[0])
                               for value in self.camera.project(touch.position[None]))
        rows, columns = self.height.shape
        return bool(0 <= row < rows and 0 <= column < columns
                    and touch.normal @ self.camera.axes[2] > 0.1
                    and self.height[int(row), int(column)] < height + PATCH)


def paint(scene: Scene, camera: Camera) -> View:
    """Return what a camera sees of a scene."""
    rows, columns = camera.shape
    image, height = np.ones((rows * columns, 3)), np.full(rows * columns, -np.inf)
    seen, places = cast(scene.field, camera)
    brightness, normals = light(scene.field, places, camera)
    image[seen] = _patched(_bone(scene, places), places, normals, scene.found.touches)
    image[seen] *= brightness[:, None]
    height[seen] = camera.project(places)[2]
    _dot(image, height, camera, scene.positions, colours.residual_colours(
        scene.found.residuals_m, scene.found.weights, scene.limits))
    return View(camera, image.reshape(rows, columns, 3), height.reshape(rows, columns))


def _bone(scene: Scene, places: Array) -> Array:
    """Return the colours of places on the bone: by the error to expect there."""
    T_tracker_bone, covariance = scene.found.T_tracker_bone, scene.found.covariance
    if T_tracker_bone is None or covariance is None:
        return np.tile(colours.rgb(colours.ERROR[0]), (len(places), 1))
    return colours.error_colours(predicted_tre(T_tracker_bone, covariance, places), scene.limits)


def _patched(bone: Array, places: Array, normals: Array, touches: Sequence[Touch]) -> Array:
    """Return the colours of the bone with those of patches to touch laid over."""
    for touch in touches:
        off = np.linalg.norm(places - touch.position, axis=1)
        inside = (off < PATCH) & (normals @ touch.normal > 0.0)
        strength = np.where(off > PATCH - RIM, 1.0, 0.55)[inside, None]
        bone[inside] += strength * (colours.rgb(colours.NEXT) - bone[inside])
    return bone


def _dot(image: Array, height: Array, camera: Camera, points: Array, looks: Array) -> None:
    """
    Draw ``points`` (n, 3) as balls of the colours ``looks`` (n, 3) where nothing is before them.

    Pixel by pixel of a ball, all balls at a time; of balls that meet in a pixel the nearest, which
    is drawn last, stays.
    """
    column, row, middle = camera.project(points)
    order = np.argsort(middle)
    column, row, middle, looks = column[order], row[order], middle[order], looks[order]
    rows, columns = camera.shape
    radius = POINT / camera.pixel
    reach = int(np.ceil(radius))
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            x, y = np.floor(column) + right, np.floor(row) + down
            aside = np.hypot(x + 0.5 - column, y + 0.5 - row) / radius
            bulge = np.sqrt(np.clip(1.0 - aside**2, 0.0, 1.0))
            drawn = np.flatnonzero((aside < 1.0) & (x >= 0) & (x < columns) & (y >= 0) & (y < rows))
            pixel = (y[drawn] * columns + x[drawn]).astype(np.intp)
            top = middle[drawn] + POINT * bulge[drawn]
            free = top > height[pixel]
            drawn, pixel = drawn[free], pixel[free]
            image[pixel] = looks[drawn] * (0.55 + 0.45 * bulge[drawn, None])
            height[pixel] = top[free]
