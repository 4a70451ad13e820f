# SPDX-License-Identifier: Apache-2.0
"""Reduce a surface to a size that a browser or a message can handle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field

Faces = NDArray[np.int32]


def drawn_surface(field: Field, max_faces: int) -> tuple[Array, Faces]:
    """
    Return vertices (n, 3), m, bone frame, and at most ``max_faces`` faces (m, 3) of a bone.

    A bone from a point cloud has no faces, and at most ``max_faces`` vertices.
    """
    if len(field.faces):
        return decimate(field.vertices, field.faces, max_faces)
    points = field.surface_points[::-(-len(field.surface_points) // max_faces)]
    return points.astype(np.float64), np.zeros((0, 3), np.int32)


def decimate(vertices: Array, faces: Faces, max_faces: int) -> tuple[Array, Faces]:
    """
    Return a mesh of at most ``max_faces`` faces, by merging the vertices within each cell.

    Vertex clustering (Rossignac and Borrel 1993) with increasing cell size. For display only: thin
    walls may close. A mesh that is small enough is returned unchanged.

    Parameters
    ----------
    vertices : (n, 3) float, m
    faces : (m, 3) int
    max_faces : int

    """
    corners = vertices[faces].astype(np.float64)
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.linalg.norm(np.cross(ab, ac), axis=1).sum()
    cell = np.sqrt(3.0 * area / max_faces)  # a surface crosses 1.5 cells per area of a cell side
    merged, kept = vertices.astype(np.float64), faces
    while len(kept) > max_faces:
        merged, kept = _cluster(vertices, faces, cell)
        cell *= 1.1
    return merged, kept


def _cluster(vertices: Array, faces: Faces, cell: float) -> tuple[Array, Faces]:
    low = vertices.min(axis=0)
    x, y, z = np.floor((vertices - low) / cell).astype(np.int64).T
    _, cluster = np.unique((x << 42) | (y << 21) | z, return_inverse=True)
    count = np.bincount(cluster)
    merged = np.stack([np.bincount(cluster, column) / count for column in vertices.T], axis=1)
    a, b, c = faces_of = cluster[faces].T
    kept = faces_of.T[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    return merged, kept[np.sort(first)].astype(np.int32)
