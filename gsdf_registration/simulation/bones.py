# SPDX-License-Identifier: Apache-2.0
"""Meshes of synthetic bones, made from implicit solids and identical on every machine."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import trimesh
from scipy import sparse

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation import femur, hip
from gsdf_registration.simulation.implicit import Points

SHAPES: dict[str, ModuleType] = {'hip': hip, 'femur': femur}
RESOLUTION = 0.01       # mm, to which vertices are rounded: processors differ in the last bits


def bone_mesh(name: str, spacing: float = 2.4) -> trimesh.Trimesh:
    """
    Return the closed surface of a synthetic bone.

    Parameters
    ----------
    name : 'hip' or 'femur'
    spacing : float, mm, of the grid on which the solid is sampled; also the length of the edges

    Returns
    -------
    trimesh.Trimesh, mm, one watertight body, faces outward

    """
    from skimage.measure import marching_cubes  # a dependency of the tests only

    shape = SHAPES[name]
    low, high = (np.array(corner) for corner in shape.BOX)
    axes = [np.arange(a, b, spacing) for a, b in zip(low, high)]
    x, y, z = np.meshgrid(*axes, indexing='ij')
    vertices, faces, _, _ = marching_cubes(shape.solid((x, y, z)), 0.0, spacing=(spacing,) * 3,
                                           gradient_direction='descent')
    mesh = trimesh.Trimesh(vertices + low, faces)
    mesh = max(mesh.split(only_watertight=False), key=lambda part: len(part.faces))
    vertices = _smoothed(shape, np.asarray(mesh.vertices), mesh.edges_unique)
    return trimesh.Trimesh(np.round(vertices / RESOLUTION) * RESOLUTION, mesh.faces, process=False)


def bone_landmarks(name: str, mesh: trimesh.Trimesh) -> dict[str, Array]:
    """Return the landmarks of the bone by name: the nearest vertices (3,) of ``mesh``, mm."""
    vertices = np.asarray(mesh.vertices)
    return {landmark: vertices[np.argmin(np.linalg.norm(vertices - np.array(place), axis=1))]
            for landmark, place in SHAPES[name].LANDMARKS.items()}


def _smoothed(shape: ModuleType, vertices: Array, edges: np.ndarray, rounds: int = 6) -> Array:
    """Move vertices toward the mean of their neighbours, then back onto the solid."""
    n = len(vertices)
    both = np.concatenate([edges, edges[:, ::-1]])
    links = sparse.coo_matrix((np.ones(len(both)), tuple(both.T)), (n, n)).tocsr()
    degree = np.asarray(links.sum(axis=1))
    for _ in range(rounds):
        vertices = vertices + 0.5 * (links @ vertices / degree - vertices)
        value, gradient = _value_and_gradient(shape, vertices)
        slope = np.maximum((gradient**2).sum(axis=1), 0.25)
        vertices = vertices - np.clip(value / slope, -1.0, 1.0)[:, None] * gradient
    return vertices


def _value_and_gradient(shape: ModuleType,
                        vertices: Array,
                        step: float = 1e-3) -> tuple[Array, Array]:
    """Return value (n,) and gradient (n, 3) of the solid, by differences over ``step`` mm."""
    shifted = np.concatenate([vertices, *(vertices + step * e for e in np.eye(3))])
    p: Points = (shifted[:, 0], shifted[:, 1], shifted[:, 2])
    value, *beside = shape.solid(p).reshape(4, -1)
    return value, (np.stack(beside, axis=1) - value[:, None]) / step
