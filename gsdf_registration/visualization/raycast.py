# SPDX-License-Identifier: Apache-2.0
"""
Ray casting on the gradient-SDF of a bone, without a display or a GPU.

The ray of a pixel advances by the distance from the field until it reaches the surface (sphere
tracing, Hart 1996). The gradient there is the normal for shading. A bone from a point cloud is
drawn like one from a mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.numba_options import kernel
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.field.sample import FieldArrays, sample

HIT = 5e-5          # m: a ray this near to the surface has hit it
STEP_SHARE = 0.95   # of the distance per step: the field is interpolated and may be slightly off
MAX_STEPS = 500     # only few rays need many steps: those that graze the bone
LIGHT = np.array([-0.35, 0.45, 0.82])       # direction to the light: left, up, towards the viewer
OCCLUSION = (0.004, 0.012)      # m along the normal, where ambient occlusion is sampled


@dataclass(frozen=True, eq=False)
class Camera:
    """
    An orthographic camera.

    centre : (3,) float, m, bone frame, in the middle of the picture
    axes : (3, 3) float, rows: to the right, up, towards the viewer
    pixel : float, m, side of a pixel on the bone
    shape : height and width of the picture, pixels
    """

    centre: Array
    axes: Array
    pixel: float
    shape: tuple[int, int]

    def project(self, points: Array) -> tuple[Array, Array, Array]:
        """Return columns, rows (pixels) and heights towards the viewer (m) of points (n, 3)."""
        right, up, height = ((points - self.centre) @ self.axes.T).T
        rows, columns = self.shape
        return right / self.pixel + 0.5 * columns, 0.5 * rows - up / self.pixel, height

    def pixels(self) -> Array:
        """Return the positions (h * w, 3), m, of all pixels on the plane through the centre."""
        rows, columns = self.shape
        right = (np.arange(columns) + 0.5 - 0.5 * columns) * self.pixel
        up = (0.5 * rows - np.arange(rows) - 0.5) * self.pixel
        return (self.centre + right[None, :, None] * self.axes[0]
                + up[:, None, None] * self.axes[1]).reshape(-1, 3)


def looking_at(points: Array, direction: Array, shape: tuple[int, int],
               margin: float = 0.0) -> Camera:
    """
    Return a camera that sees all ``points`` (n, 3), m, bone frame, with z of the bone upright.

    Parameters
    ----------
    points : (n, 3) float
    direction : (3,) float
        From the bone towards the viewer.
    shape : height and width, pixels
    margin : float, m
        Around the points.

    """
    back = direction / np.linalg.norm(direction)
    upright = np.eye(3)[2 if abs(back[2]) < 0.9 else 1]     # y for a view along z
    right = np.cross(upright, back)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(back, right), back])
    projected = points @ axes.T
    low, high = projected.min(axis=0), projected.max(axis=0)
    side = ((high - low)[:2] + 2.0 * margin) / (shape[1], shape[0])
    return Camera(0.5 * (low + high) @ axes, axes, float(side.max()), shape)


def cast(field: Field, camera: Camera) -> tuple[NDArray[np.intp], Array]:
    """Return the flat indices (k,) of pixels on the bone, and the points hit, (k, 3), m."""
    back = camera.axes[2]
    at = camera.pixels()
    # from where the ray enters the bounding box to where it leaves it
    slope = np.where(np.abs(back) < 1e-12, 1e-12, back)
    ends = (field.bounds + np.array([[-0.002], [0.002]]) - at[:, None]) / slope
    nearest, farthest = ends.max(axis=1).min(axis=1), ends.min(axis=1).max(axis=1)
    visible = np.flatnonzero(nearest > farthest)
    at = at[visible] + nearest[visible, None] * back
    hit = _advance(field.arrays, at, back, (nearest - farthest)[visible])
    return visible[hit], at[hit]


@kernel
def _advance(field: FieldArrays, at: Array, back: Array, length: Array) -> NDArray[np.bool_]:
    """
    Move positions ``at`` (n, 3) against ``back`` (3,) to the surface; return which reach it (n,).

    Each gives up after its ``length`` (n,), m.
    """
    hit = np.zeros(len(at), np.bool_)
    for i in range(len(at)):
        x, y, z = at[i]
        left = length[i]
        for _ in range(MAX_STEPS):
            distance = sample(field, x, y, z)[0]
            step = STEP_SHARE * distance
            x -= step * back[0]
            y -= step * back[1]
            z -= step * back[2]
            left -= step
            if distance < HIT:
                hit[i] = True
                break
            if left <= 0.0:
                break
        at[i] = x, y, z
    return hit


def light(field: Field, places: Array, camera: Camera) -> tuple[Array, Array]:
    """Return the brightness (n,) in [0, 1] and the normals (n, 3) at ``places`` (n, 3), m."""
    _, normals = field.sample(places)
    source = LIGHT / np.linalg.norm(LIGHT) @ camera.axes
    brightness = 0.5 + 0.5 * np.clip(normals @ source, 0.0, 1.0)
    for distance in OCCLUSION:
        free = np.clip(field.sample(places + distance * normals)[0] / distance, 0.0, 1.0)
        brightness *= 0.72 + 0.28 * free
    return brightness, normals
