# SPDX-License-Identifier: Apache-2.0
"""
A picture of the bone straight from its gradient-SDF, on any machine, with no display.

Every pixel is a ray that walks on by the distance the field gives until that is nothing (sphere
tracing, Hart 1996); the gradient there is the normal that the light falls on.  So a bone that came
as a point cloud looks like any other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field

TOUCHING = 5e-5     # m: a ray this near to the surface is on it
CAUTION = 0.95      # of the distance is walked: between its nodes the field may be off a little
STEPS = 500         # few rays need many: those that graze the bone
LIGHT = np.array([-0.35, 0.45, 0.82])       # where it comes from: left, above, mostly behind us
NOOKS = (0.004, 0.012)      # m: so far out we look for what shades a place


@dataclass(frozen=True, eq=False)
class Camera:
    """
    A view from afar, all rays parallel.

    centre : (3,) float, m, bone frame: what is in the middle of the picture
    axes : (3, 3) float, rows: to the right, up, towards the viewer
    pixel : float, m, side of a pixel on the bone
    shape : height and width of the picture, pixels
    """

    centre: Array
    axes: Array
    pixel: float
    shape: tuple[int, int]

    def project(self, points: Array) -> tuple[Array, Array, Array]:
        """Return columns and rows (pixels), and heights towards the viewer (m) of points (n, 3)."""
        right, up, height = ((points - self.centre) @ self.axes.T).T
        rows, columns = self.shape
        return right / self.pixel + 0.5 * columns, 0.5 * rows - up / self.pixel, height

    def pixels(self) -> Array:
        """Return the places (h * w, 3), m, of all pixels on the plane through the centre."""
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
        Round the points.

    """
    back = direction / np.linalg.norm(direction)
    upright = np.eye(3)[2 if abs(back[2]) < 0.9 else 1]     # y, if we look along z
    right = np.cross(upright, back)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(back, right), back])
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    side = ((high - low)[:2] + 2.0 * margin) / (shape[1], shape[0])
    return Camera(0.5 * (low + high) @ axes, axes, float(side.max()), shape)


def cast(field: Field, camera: Camera) -> tuple[NDArray[np.intp], Array]:
    """Return which pixels (flat) see the bone, and where on it, (k, 3), m, bone frame."""
    back = camera.axes[2]
    at = camera.pixels()
    # from where the ray enters the box round the bone to where it leaves it
    slope = np.where(np.abs(back) < 1e-12, 1e-12, back)
    ends = (field.bounds + np.array([[-0.002], [0.002]]) - at[:, None]) / slope
    nearest, farthest = ends.max(axis=1).min(axis=1), ends.min(axis=1).max(axis=1)
    walking = np.flatnonzero(nearest > farthest)
    at += nearest[:, None] * back
    touched = []
    for _ in range(STEPS):
        distance, _ = field.sample(at[walking])
        at[walking] -= CAUTION * distance[:, None] * back
        nearest[walking] -= CAUTION * distance
        there = distance < TOUCHING
        touched.append(walking[there])
        walking = walking[~there & (nearest[walking] > farthest[walking])]
        if not len(walking):
            break
    seen = np.sort(np.concatenate(touched))
    return seen, at[seen]


def light(field: Field, places: Array, camera: Camera) -> tuple[Array, Array]:
    """Return the light (n,) in [0, 1] on ``places`` (n, 3), m, of the bone; normals (n, 3)."""
    _, normals = field.sample(places)
    source = LIGHT / np.linalg.norm(LIGHT) @ camera.axes
    brightness = 0.5 + 0.5 * np.clip(normals @ source, 0.0, 1.0)
    for far in NOOKS:       # what stands near takes light away
        free = np.clip(field.sample(places + far * normals)[0] / far, 0.0, 1.0)
        brightness *= 0.72 + 0.28 * free
    return brightness, normals
