# SPDX-License-Identifier: Apache-2.0
"""The gradient-SDF of a bone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field.sample import FieldArrays, sample_many


@dataclass(frozen=True, eq=False)
class Field:
    """
    Signed distance to a bone and its gradient at any point, bone frame.

    arrays : FieldArrays, for the compiled kernels
    bone_sha256 : hash of the bone
    bounds : (2, 3) float64, m, lower and upper corner of the bounding box
    surface_points, surface_normals : (k, 3) float32, m, uniform sample of the surface, about one
        point per 4 mm^2
    vertices, faces : (n, 3) float32, m, and (m, 3) int32, the surface for drawing; a point cloud
        has no faces
    notes : the repairs of the bone, one sentence each
    """

    arrays: FieldArrays
    bone_sha256: str
    bounds: Array
    surface_points: np.ndarray
    surface_normals: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def voxel_size(self) -> float:
        """Spacing of the fine nodes, m."""
        return float(self.arrays.voxel)

    @property
    def extent(self) -> float:
        """The longest side of the bounding box of the surface, m."""
        return float(np.ptp(self.bounds, axis=0).max())

    @property
    def nbytes(self) -> int:
        """Memory used by all arrays, bytes."""
        a = self.arrays
        return sum(array.nbytes for array in (a.block_of, a.nodes, self.surface_points,
                                              self.surface_normals, self.vertices, self.faces))

    def sample(self, points: ArrayLike) -> tuple[Array, Array]:
        """
        Return signed distance and unit gradient at points, which may be outside the grid.

        Parameters
        ----------
        points : (n, 3) float, metres, bone frame

        Returns
        -------
        distance : (n,) float64, m, negative inside the bone
        gradient : (n, 3) float64, outward

        Raises
        ------
        InputError
            If the points are not rows of three finite numbers.

        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError('points to sample must be rows of three finite numbers')
        distance = np.empty(len(points))
        gradient = np.empty((len(points), 3))
        sample_many(self.arrays, points, distance, gradient)
        return distance, gradient
