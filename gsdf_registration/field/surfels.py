# SPDX-License-Identifier: Apache-2.0
"""Signed distance and gradient of a point cloud with normals: every point is a small disc, a surfel."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration.rigid import Array


class Surfels:
    """
    Discs that cover the surface between the points of a cloud.

    Parameters
    ----------
    points : (n, 3) float64
    normals : (n, 3) float64, unit length, outward
    threads : int

    """

    def __init__(self, points: Array, normals: Array, threads: int) -> None:
        self._tree = cKDTree(points)
        self._normals = normals
        self._threads = threads
        # as far as the sixth neighbour: neighbouring discs overlap, holes of the cloud stay holes
        self._radii = self._tree.query(points, k=[min(7, len(points))], workers=threads)[0][:, 0]

    def sample(self, x: Array) -> np.ndarray:
        """Return distance and gradient (..., 4) float32 at ``x`` (..., 3), to the disc of the nearest point."""
        _, nearest = self._tree.query(x, workers=self._threads)
        offset = x - self._tree.data[nearest]
        normal = self._normals[nearest]
        height = np.einsum('...i,...i->...', offset, normal)
        side = offset - height[..., None] * normal
        length = np.linalg.norm(side, axis=-1)
        # what sticks out beyond the rim of the disc
        beyond = np.maximum(1.0 - self._radii[nearest] / np.where(length > 0.0, length, np.inf), 0.0)
        beyond[length == 0.0] = 0.0
        to_surface = height[..., None] * normal + beyond[..., None] * side
        distance = np.copysign(np.linalg.norm(to_surface, axis=-1), height)
        on_surface = np.abs(distance) < 1e-12
        gradient = np.where(on_surface[..., None], normal,
                            to_surface / np.where(on_surface, 1.0, distance)[..., None])
        return np.concatenate([distance[..., None], gradient], axis=-1).astype(np.float32)
