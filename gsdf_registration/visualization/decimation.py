# SPDX-License-Identifier: Apache-2.0
"""A surface light enough to be drawn, in a browser or from a message."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field

Faces = NDArray[np.int32]


def drawn_surface(field: Field, most: int) -> tuple[Array, Faces]:
    """
    Return vertices (n, 3), m, bone frame, and at most ``most`` faces (m, 3) of a bone.

    Of a bone that came as a point cloud, at most ``most`` points spread over it, and no faces.
    """
    if len(field.faces):
        return reduced(field.vertices, field.faces, most)
    points = field.surface_points[::-(-len(field.surface_points) // most)]
    return points.astype(np.float64), np.zeros((0, 3), np.int32)


def reduced(vertices: Array, faces: Faces, most: int) -> tuple[Array, Faces]:
    """
    Return a mesh of at most ``most`` faces: itself, or one whose vertices were merged cell by cell.

    Vertex clustering (Rossignac and Borrel 1993) on ever coarser cells; for drawing only, thin
    walls may close.

    Parameters
    ----------
    vertices : (n, 3) float, m
    faces : (m, 3) int

    """
    corners = vertices[faces].astype(np.float64)
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.linalg.norm(np.cross(ab, ac), axis=1).sum()
    cell = np.sqrt(3.0 * area / most)   # a surface meets about 1.5 cells on the area of one's side
    thin, kept = vertices.astype(np.float64), faces
    while len(kept) > most:
        thin, kept = _clustered(vertices, faces, cell)
        cell *= 1.1
    return thin, kept


def _clustered(vertices: Array, faces: Faces, cell: float) -> tuple[Array, Faces]:
    low = vertices.min(axis=0)
    x, y, z = np.floor((vertices - low) / cell).astype(np.int64).T
    _, cluster = np.unique((x << 42) | (y << 21) | z, return_inverse=True)
    count = np.bincount(cluster)
    merged = np.stack([np.bincount(cluster, column) / count for column in vertices.T], axis=1)
    a, b, c = faces_of = cluster[faces].T
    kept = faces_of.T[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    return merged, kept[np.sort(first)].astype(np.int32)
