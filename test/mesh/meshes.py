# SPDX-License-Identifier: Apache-2.0
"""Meshes for the tests of the mesh package."""

from __future__ import annotations

import numpy as np
import trimesh

Mesh = tuple[np.ndarray, np.ndarray]


def blob(subdivisions: int = 3) -> Mesh:
    """Return vertices and faces of an asymmetric body of the size of a bone, m."""
    mesh = trimesh.creation.icosphere(subdivisions)
    v = np.array(mesh.vertices)
    r = 1.0 + 0.2 * np.sin(3.0 * v[:, 0]) + 0.15 * np.cos(4.0 * v[:, 1] + 1.0) * v[:, 2]
    return v * r[:, None] * [0.05, 0.04, 0.08], np.array(mesh.faces)


def two(first: Mesh, second: Mesh) -> Mesh:
    """Return two meshes as one."""
    return np.vstack([first[0], second[0]]), np.vstack([first[1], second[1] + len(first[0])])


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the signed volume of a closed mesh, m^3; positive if it is oriented outward."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float((np.cross(a, b) * c).sum() / 6.0)
