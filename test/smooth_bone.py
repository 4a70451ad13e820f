# SPDX-License-Identifier: Apache-2.0
"""A small, smooth, asymmetric bone and points on its surface."""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh

from gsdf_registration.common.rigid import Array, exp
from gsdf_registration.field import Field, build_field
from gsdf_registration.mesh.bone import make_bone

LANDMARKS = np.array([[0.034, 0.0, 0.0], [0.0, 0.045, 0.0], [0.0, 0.0, 0.066]])
T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])


def ball_mesh(radii: Array, bumps: tuple[tuple[Array, float], ...] = ()) -> trimesh.Trimesh:
    """Return an ellipsoid, m, with smooth ``bumps``: direction and relative height of each."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    scale = np.ones(len(ball.vertices))
    for direction, height in bumps:
        scale += height * np.exp(4.0 *
                                 (ball.vertices @ (direction / np.linalg.norm(direction)) - 1.0))
    return trimesh.Trimesh(ball.vertices * radii * scale[:, None], ball.faces, process=False)


@cache
def bone_mesh() -> trimesh.Trimesh:
    """Return the surface of the bone, m."""
    return ball_mesh(np.array([0.03, 0.04, 0.055]),
                     ((np.array([1.0, 1.0, 0.6]), 0.5), (np.array([-1.0, 0.3, -1.0]), 0.4),
                      (np.array([0.2, -1.0, 0.8]), -0.3)))


def field_of(mesh: trimesh.Trimesh, voxel_size: float = 0.001) -> Field:
    """Return the field of a mesh in metres."""
    return build_field(make_bone(np.asarray(mesh.vertices), np.asarray(mesh.faces)), voxel_size)


@cache
def bone_field() -> Field:
    """Return the field of the bone."""
    return field_of(bone_mesh())


def touched_points(n: int, seed: int = 0, sigma: float = 0.0, radius: float = 0.045,
            mesh: trimesh.Trimesh | None = None) -> Array:
    """
    Return ``n`` points (n, 3) on the surface, bone frame, m, with isotropic noise.

    They are within ``radius`` of the surface point with the largest x, as if exposed by an
    incision.
    """
    mesh = bone_mesh() if mesh is None else mesh
    rng = np.random.default_rng(seed)
    points, _ = trimesh.sample.sample_surface(mesh, 40_000, seed=seed)
    centre = mesh.vertices[np.argmax(mesh.vertices[:, 0])]
    near = points[np.linalg.norm(points - centre, axis=1) < radius]
    chosen = near[rng.choice(len(near), n, replace=False)]
    return np.asarray(chosen + sigma * rng.normal(size=chosen.shape))


def with_model_error(points: Array, seed: int, sigma: float, length: float) -> Array:
    """
    Return points (n, 3) of the bone, m, moved along the normals by an error of the model.

    The error is a random field with standard deviation ``sigma`` and a Matern 3/2 covariance with
    the correlation length ``length``, m, approximated by a sum of waves.
    """
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(500, 3)) / length / np.sqrt(rng.chisquare(3, (500, 1)) / 3.0)
    phases = rng.uniform(0.0, 2.0 * np.pi, 500)
    error = sigma * np.sqrt(2.0 / 500) * np.cos(points @ waves.T + phases).sum(axis=1)
    return np.asarray(points + error[:, None] * bone_field().sample(points)[1])


@cache
def plate_field() -> Field:
    """Return the field of a plate whose wavy upper side has the same shape seen from inside."""
    plate = trimesh.creation.box((0.08, 0.08, 0.02))
    for _ in range(5):
        plate = plate.subdivide()
    upper = plate.vertices[:, 2] > 0.0
    plate.vertices[upper] = on_plate(plate.vertices[upper, :2]) + [0.0, 0.0, 1.0] * (
        plate.vertices[upper] - [0.0, 0.0, 0.01])
    return field_of(plate, 0.002)


def on_plate(at: Array) -> Array:
    """Return the points (n, 3) of the upper side of the plate at ``at`` (n, 2), m."""
    x, y = at.T
    height = 0.01 + 0.004 * np.sin(80.0 * y) * (1.0 + 0.4 * np.sin(90.0 * x + 1.0))
    return np.column_stack([x, y, height])
