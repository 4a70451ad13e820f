# SPDX-License-Identifier: Apache-2.0
"""Point-to-triangle distances by brute force, independent of the package."""

from __future__ import annotations

import numpy as np


def distances(points: np.ndarray, corners: np.ndarray, within: float = 0.02) -> np.ndarray:
    """Return distances (n,) from points (n, 3) to triangles (m, 3, 3), exact up to ``within``."""
    return np.array([_distance(p, corners[np.linalg.norm(corners[:, 0] - p, axis=1) < within])
                     for p in points])


def _distance(p: np.ndarray, corners: np.ndarray) -> float:
    if len(corners) == 0:
        return np.inf
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    height = ((p - corners[:, 0]) * normals).sum(axis=1)
    above = np.ones(len(corners), dtype=bool)
    nearest = np.inf
    for a, b in zip(np.moveaxis(corners, 1, 0), np.moveaxis(np.roll(corners, -1, axis=1), 1, 0)):
        edge = b - a
        above &= (np.cross(edge, p - a) * normals).sum(axis=1) >= 0.0
        t = np.clip(((p - a) * edge).sum(axis=1) / (edge**2).sum(axis=1), 0.0, 1.0)
        nearest = min(nearest, np.linalg.norm(p - a - t[:, None] * edge, axis=1).min())
    return min(nearest, np.abs(height[above]).min(initial=np.inf))
