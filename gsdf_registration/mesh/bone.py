# SPDX-License-Identifier: Apache-2.0
"""The surface of a bone: a valid, outward-oriented mesh or point cloud."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gsdf_registration.common.formatting import format_count, format_length
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.rigid import Array
from gsdf_registration.mesh import repair as mesh_repair
from gsdf_registration.mesh.bodies import choose_bone

MIN_EXTENT, MAX_EXTENT = 0.02, 2.0   # extent of a bone, m

_log = logging.getLogger('gsdf_registration')


@dataclass(frozen=True, eq=False)
class Bone:
    """
    The surface of a bone in the bone frame, made by `make_bone`.

    vertices : (n, 3) float64, m
    faces : (m, 3) int32, counter-clockwise seen from outside; None for a point cloud
    normals : (n, 3) float64, unit length, outward; None for a mesh
    notes : the repairs, one sentence each
    """

    vertices: Array
    faces: np.ndarray | None
    normals: Array | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def bounds(self) -> Array:
        """Lower and upper corner of the bounding box, (2, 3) m."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extent(self) -> float:
        """The longest side of the bounding box, m."""
        return float(np.ptp(self.bounds, axis=0).max())

    @cached_property
    def sha256(self) -> str:
        """The hash of the geometry, by which fields and sessions identify their bone."""
        digest = hashlib.sha256()
        for name, array in (('vertices', self.vertices), ('faces', self.faces), ('normals',
                                                                                 self.normals)):
            if array is not None:
                digest.update(f'{name}{array.shape}'.encode())
                digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder('<')).data)
        return digest.hexdigest()


def make_bone(vertices: Array,
              faces: np.ndarray | None = None,
              normals: Array | None = None, body: str = '') -> Bone:
    """
    Validate, repair and orient the surface of a bone.

    Parameters
    ----------
    vertices : (n, 3) float, metres
    faces : (m, 3) int, triangles as rows of vertex indices; None for a point cloud
    normals : (n, 3) float, outward; required for a point cloud, ignored for a mesh
    body : str
        Which bone of a mesh of several: a number, 'largest' or 'all'; see `bodies.choose_bone`.

    Returns
    -------
    Bone
        Its ``notes`` list the repairs; they are also logged in one warning.

    Raises
    ------
    InputError
        If the surface is not valid or has several bones (`bad_input`), or is not of the size of a
        bone (`wrong_unit`).

    """
    vertices = _checked(vertices, 'vertices')
    if len(vertices) == 0:
        raise InputError('the model is empty; use a triangle mesh or a point cloud with normals')
    _check_size(vertices)
    if faces is not None and len(faces):
        bone = _bone_of_mesh(vertices, _checked_faces(faces, len(vertices)), body)
    elif normals is not None:
        bone = _bone_of_cloud(vertices, _checked(normals, 'normals'))
    else:
        raise InputError('the model has neither faces nor normals; '
                         'use a triangle mesh or a point cloud with normals')
    _check_size(bone.vertices)
    warn_of_repairs(bone.notes)
    return bone


def warn_of_repairs(notes: tuple[str, ...]) -> None:
    """Log the repairs of a bone in one warning, if there are any."""
    if notes:
        _log.warning('the bone model was repaired: %s', ' '.join(notes))


def _bone_of_mesh(vertices: Array, faces: np.ndarray, body: str) -> Bone:
    """Repair a mesh, and choose one of its bones."""
    notes: list[str] = []
    vertices, faces = mesh_repair.merge_vertices(vertices, faces, notes)
    faces = mesh_repair.drop_invalid_faces(vertices, faces, notes)
    if len(faces) == 0:
        raise InputError('all faces of the model have zero area; export the surface again')
    faces, bodies = mesh_repair.wind_consistently(faces, notes)
    keep = mesh_repair.large_bodies(vertices, faces, bodies, notes)
    faces, bodies = faces[keep], bodies[keep]
    faces = mesh_repair.orient_outward(vertices, faces, bodies, notes)
    keep = mesh_repair.outer_bodies(vertices, faces, bodies, notes)
    faces, bodies = faces[keep], bodies[keep]
    faces = faces[choose_bone(vertices, faces, bodies, body)]
    vertices, faces = mesh_repair.drop_unused_vertices(vertices, faces)
    return Bone(vertices, faces.astype(np.int32), None, tuple(notes))


def _bone_of_cloud(points: Array, normals: Array) -> Bone:
    """Normalize the normals of a point cloud and drop duplicate points."""
    if normals.shape != points.shape:
        raise InputError(f'the model has {format_count(len(points), "point")} but '
                         f'{format_count(len(normals), "normal")}; provide one normal per point')
    lengths = np.linalg.norm(normals, axis=1)
    if (lengths < 1e-6).any():
        raise InputError(f'normal {int(lengths.argmin())} of the model has zero length; '
                         'estimate the normals again')
    notes = []
    if np.abs(lengths - 1.0).max() > 1e-3:
        notes.append('The normals were scaled to unit length.')
    _, first = np.unique(points, axis=0, return_index=True)
    if len(first) < len(points):
        notes.append(f'Dropped {format_count(len(points) - len(first), "duplicate point")}.')
    first.sort()
    return Bone(points[first], None, normals[first] / lengths[first, None], tuple(notes))


def _checked(array: Array, what: str) -> Array:
    """Return ``array`` as (n, 3) float64; raise `InputError` if it is not finite."""
    array = np.ascontiguousarray(array, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f'the {what} of the model must be rows of three numbers, '
                         f'not an array of shape {array.shape}')
    bad = ~np.isfinite(array).all(axis=1)
    if bad.any():
        raise InputError(
            f'{int(bad.sum())} of the {what} of the model are not finite, the first in row '
            f'{int(bad.argmax())}; export the model again')
    return array


def _checked_faces(faces: np.ndarray, n: int) -> np.ndarray:
    """Return ``faces`` as (m, 3) int64; raise `InputError` if an index is not in range(n)."""
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise InputError(
            'the faces of the model must be rows of three vertex indices; triangulate it first')
    bad = ((faces < 0) | (faces >= n)).any(axis=1)
    if bad.any():
        raise InputError(f'face {int(bad.argmax())} of the model refers to a vertex that does not '
                         f'exist; the model has {n} vertices')
    return faces.astype(np.int64)


def _check_size(vertices: Array) -> None:
    """Raise `InputError` if the size is not that of a bone."""
    extent = float(np.ptp(vertices, axis=0).max())
    if not MIN_EXTENT <= extent <= MAX_EXTENT:
        given, meant = ('mm', 'm') if extent < MIN_EXTENT else ('m', 'mm')
        raise InputError(f'the model has an extent of {format_length(extent)}, but a bone has '
                         f'{MIN_EXTENT * 1e3:.0f} mm to {MAX_EXTENT:.0f} m: its unit is probably '
                         f'{meant}, not {given}', Reason.WRONG_UNIT)
