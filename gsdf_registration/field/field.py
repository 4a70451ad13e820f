# SPDX-License-Identifier: Apache-2.0
"""The gradient-SDF of a bone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.field.sample import FieldArrays, sample_many


@dataclass(frozen=True, eq=False)
class Field:
    """
    Signed distance to a bone and its gradient at any point, bone frame.

    The distance is that to the surface on which the positions of the probe lie: the bone itself, or
    for the centre of a ball tip the bone moved outward by the radius, see `for_tip`.

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
    def tip_radius(self) -> float:
        """Radius of the ball tip whose centre lies on the surface, m; 0: the bone itself."""
        return self.arrays.offset

    @property
    def nbytes(self) -> int:
        """Memory used by all arrays, bytes."""
        a = self.arrays
        return sum(array.nbytes for array in (a.block_of, a.nodes, self.surface_points,
                                              self.surface_normals, self.vertices, self.faces))

    def for_tip(self, radius: float) -> Field:
        """
        Return the field for the centre of a ball tip, which shares all arrays.

        The centre of a ball of radius r that touches the bone lies on {SDF = r}. The distance to
        this surface is SDF - r outside the medial axis of the bone, and its gradient is that of the
        SDF. The surface points, vertices, bounds and the hash stay those of the bone.

        Parameters
        ----------
        radius : float, m
            0: a tip without extent, whose field is that of the bone, also after another radius.

        Raises
        ------
        InputError
            If the radius is negative or not finite.

        """
        if not (math.isfinite(radius) and radius >= 0.0):
            raise InputError(f'the radius of the probe tip must be 0 or a positive number of '
                             f'metres, not {radius:g}')
        return self.moved_outward(float(radius))

    def moved_outward(self, offset: float) -> Field:
        """Return the field of the bone moved outward by ``offset``, m; inward if negative."""
        if offset == self.arrays.offset:
            return self
        return replace(self, arrays=self.arrays._replace(offset=offset))

    def contacts(self, points: ArrayLike) -> Array:
        """
        Return where a ball tip touches the bone, or would touch it first.

        Parameters
        ----------
        points : (n, 3) float, m, bone frame, centres of the ball; rows that are not finite are kept

        Returns
        -------
        (n, 3) float64, m, the centres moved inward along the normal by the radius

        """
        contacts = np.array(points, dtype=np.float64)
        if self.tip_radius != 0.0:
            finite = np.isfinite(contacts).all(axis=1)
            normals = self.sample(contacts[finite])[1]
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            contacts[finite] -= self.tip_radius * normals
        return contacts

    def contacts_at(self, T_tracker_bone: Array, positions: Array) -> Array:
        """Return `contacts` (n, 3), bone frame, of tips (n, 3), m, tracker frame, at a pose."""
        return self.contacts(transform(inverse(T_tracker_bone), positions))

    def sample(self, points: ArrayLike) -> tuple[Array, Array]:
        """
        Return signed distance and unit gradient at points, which may be outside the grid.

        For a ball tip the distance is negative where the ball penetrates the bone, and the gradient
        is short where two walls are equally near, see `field.sample`.

        Parameters
        ----------
        points : (n, 3) float, metres, bone frame

        Returns
        -------
        distance : (n,) float64, m, negative inside the surface
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
