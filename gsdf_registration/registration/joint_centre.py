# SPDX-License-Identifier: Apache-2.0
"""The centre of the hip joint on a model: of the sphere of the femoral head or the acetabulum."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.field.surface import SPACING

RADII = (0.015, 0.032)      # m, of heads and cups
# m^2, smallest areas; other round parts of 40 bones have at most 0.0008 (hollow) and 0.0020
CUP_AREA, HEAD_AREA = 0.0011, 0.0028
TOLERANCE = 0.0015          # m, from the sphere: a head is not quite round
FACING = 0.95               # cosine of the largest angle between normal and radius
FAR = 0.05                  # m, between two points of a head, about its diameter
TRIES = 4000                # pairs of points, of which one of a hundred lies on the head
SAMPLES = 4000              # points of the surface
BATCH = 100                 # tries between two reports of progress
REFINEMENTS = 10


class JointCentre(NamedTuple):
    """
    A spherical part of the surface.

    centre : (3,) float, m, bone frame
    radius : float, m
    rms : float, m, of the distances of its points from the sphere
    area : float, m^2
    hollow : whether it is a cup
    """

    centre: Array
    radius: float
    rms: float
    area: float
    hollow: bool


def find_hip_centre(field: Field,
                    progress: Callable[[float], None] = lambda share: None) -> JointCentre:
    """
    Return the largest spherical part of a bone, a femoral head or an acetabulum.

    RANSAC (Fischler and Bolles 1981): the normals of two points on a sphere meet at its centre.
    Then least squares through the points on it, repeated until they do not change.

    Parameters
    ----------
    field : Field
    progress : callable
        Called with the finished share, 0 to 1.

    Raises
    ------
    InputError
        If no part of the bone is a sphere of the size of a hip joint.

    """
    surface = field.surface_points.astype(np.float64)
    outward = field.surface_normals.astype(np.float64)
    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(surface))[:SAMPLES]
    found = []
    for hollow, smallest in ((False, HEAD_AREA), (True, CUP_AREA)):
        toward = outward if hollow else -outward        # the centre
        sphere = _search(surface[chosen], toward[chosen], rng,
                         partial(_report, progress, 0.5 * hollow))
        sphere = None if sphere is None else _refined(surface, toward, *sphere)
        if sphere is not None:
            on = _on_sphere(surface, toward, *sphere)
            area = SPACING**2 * float(on.sum())
            if area > smallest:
                away = np.linalg.norm(surface[on] - sphere[0], axis=1) - sphere[1]
                found.append(JointCentre(*sphere, rigid.rms(away), area, hollow))
    if not found:
        raise InputError(
            'the bone has no femoral head or acetabulum, no spherical part with a radius of '
            f'{1e3 * RADII[0]:.0f} to {1e3 * RADII[1]:.0f} mm; check the model and its unit')
    # a head is larger than a cup; the area of other round parts is a small part of either
    return max(found, key=lambda each: each.area / (CUP_AREA if each.hollow else HEAD_AREA))


def _report(progress: Callable[[float], None], before: float, share: float) -> None:
    progress(before + 0.5 * share)      # one half for heads, one for cups


def _search(points: Array, toward: Array, rng: np.random.Generator,
            progress: Callable[[float], None]) -> tuple[Array, float] | None:
    """Return centre and radius of the sphere with the most points; None if no pair has one."""
    i, j = rng.integers(0, len(points), (2, 40 * TRIES))
    cosine = (toward[i] * toward[j]).sum(axis=1)
    near = (np.linalg.norm(points[i] - points[j], axis=1) < FAR) & (np.abs(cosine) < 0.9)
    i, j, cosine = i[near][:TRIES], j[near][:TRIES], cosine[near][:TRIES]
    gap = points[j] - points[i]
    along_i, along_j = (gap * toward[i]).sum(axis=1), (gap * toward[j]).sum(axis=1)
    r_i = (along_i - cosine * along_j) / (1.0 - cosine**2)
    r_j = (cosine * along_i - along_j) / (1.0 - cosine**2)
    centres = 0.5 * (points[i] + r_i[:, None] * toward[i] + points[j] + r_j[:, None] * toward[j])
    radii = 0.5 * (r_i + r_j)
    valid = (np.abs(r_i - r_j) < 2.0 * TOLERANCE) & (radii > RADII[0]) & (radii < RADII[1])
    best, found = 0, None
    for k, (centre, radius) in enumerate(zip(centres[valid], radii[valid].tolist())):
        count = int(_on_sphere(points, toward, centre, radius).sum())
        if count > best:
            best, found = count, (centre, radius)
        if k % BATCH == 0:
            progress(k / int(valid.sum()))
    progress(1.0)
    return found


def _refined(points: Array, toward: Array, centre: Array,
             radius: float) -> tuple[Array, float] | None:
    """Return the least-squares sphere through its points: |x|^2 = 2 c.x + (r^2 - |c|^2)."""
    before = None
    for _ in range(REFINEMENTS):
        on = _on_sphere(points, toward, centre, radius)
        if on.sum() < 10:
            return None
        if before is not None and np.array_equal(on, before):
            break
        before, middle = on, points[on].mean(axis=0)
        x = points[on] - middle
        rows = np.column_stack([2.0 * x, np.full(len(x), radius)])
        solution = np.linalg.lstsq(rows, (x**2).sum(axis=1), rcond=None)[0]
        centre = middle + solution[:3]
        radius = float(np.sqrt(radius * solution[3] + solution[:3] @ solution[:3]))
    return (centre, radius) if RADII[0] < radius < RADII[1] else None


def _on_sphere(points: Array, toward: Array, centre: Array, radius: float) -> NDArray[np.bool_]:
    """Return which points lie on a sphere with normals toward its centre."""
    ray = centre - points
    away = np.linalg.norm(ray, axis=1)
    return np.asarray((np.abs(away - radius) < TOLERANCE)
                      & ((ray * toward).sum(axis=1) > FACING * away))


def extreme_points(field: Field) -> Array:
    """
    Return four places (4, 3), m, of the surface that are far from each other.

    The two ends of the bone, the place farthest from the line through them, and the place farthest
    from the plane through all three: together they determine a pose well.
    """
    x = field.surface_points.astype(np.float64)
    x = x[np.argsort(x @ [1.0, 1e-3, 1e-6], kind='stable')]     # the order of points is no reason
    first = x[np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1))]
    second = x[np.argmax(np.linalg.norm(x - first, axis=1))]
    along = (second - first) / np.linalg.norm(second - first)
    third = x[np.argmax(np.linalg.norm(np.cross(x - first, along), axis=1))]
    normal = np.cross(along, third - first)
    return np.array([first, second, third, x[np.argmax(np.abs((x - first) @ normal))]])
