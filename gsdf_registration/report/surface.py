# SPDX-License-Identifier: Apache-2.0
"""A surface light enough to be drawn in a browser."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.rigid import Array


def reduced(vertices: Array, faces: NDArray[np.int32],
            most: int = 30_000) -> tuple[Array, NDArray[np.int32]]:
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
    thin, kept = vertices, faces
    while len(kept) > most:
        thin, kept = _clustered(vertices, faces, cell)
        cell *= 1.1
    return thin, kept


def _clustered(vertices: Array, faces: NDArray[np.int32],
               cell: float) -> tuple[Array, NDArray[np.int32]]:
    low = vertices.min(axis=0)
    x, y, z = np.floor((vertices - low) / cell).astype(np.int64).T
    _, cluster = np.unique((x << 42) | (y << 21) | z, return_inverse=True)
    count = np.bincount(cluster)
    merged = np.stack([np.bincount(cluster, column) / count for column in vertices.T], axis=1)
    a, b, c = faces_of = cluster[faces].T
    kept = faces_of.T[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    return merged, kept[np.sort(first)].astype(np.int32)
