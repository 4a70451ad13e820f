# SPDX-License-Identifier: Apache-2.0
"""The bone to look for: one clean, outward-oriented surface, made of what a segmentation left."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gsdf_registration.common.formatting import counted, length
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.rigid import Array
from gsdf_registration.mesh import repair as mesh_repair

SMALLEST, LARGEST = 0.02, 2.0   # extent of a bone, m

_log = logging.getLogger('gsdf_registration')


@dataclass(frozen=True, eq=False)
class Bone:
    """
    The surface of a bone, metres, bone frame; made by `make_bone`.

    vertices : (n, 3) float64
    faces : (m, 3) int32, wound so that their normals point out of the bone; None for a point cloud
    normals : (n, 3) float64, unit length, out of the bone; None for a mesh
    notes : what was repaired, a sentence each
    """

    vertices: Array
    faces: np.ndarray | None
    normals: Array | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def bounds(self) -> Array:
        """Low and high corner of the bounding box, (2, 3)."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extent(self) -> float:
        """The longest side of the bounding box."""
        return float(np.ptp(self.bounds, axis=0).max())

    @cached_property
    def sha256(self) -> str:
        """The hash of the geometry: what a field or a session is bound to."""
        digest = hashlib.sha256()
        for name, array in (('vertices', self.vertices), ('faces', self.faces), ('normals',
                                                                                 self.normals)):
            if array is not None:
                digest.update(f'{name}{array.shape}'.encode())
                digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder('<')).data)
        return digest.hexdigest()


def make_bone(vertices: Array,
              faces: np.ndarray | None = None,
              normals: Array | None = None) -> Bone:
    """
    Check, clean and orient the surface of a bone.

    Parameters
    ----------
    vertices : (n, 3) float, metres
    faces : (m, 3) int, triangles as rows of vertex indices; None for a point cloud
    normals : (n, 3) float, out of the bone; needed for a point cloud, not used for a mesh

    Returns
    -------
    Bone
        What was repaired stands in its ``notes`` and is logged once as a warning.

    Raises
    ------
    InputError
        If this is no surface (`bad_input`), or its size is not a bone's (`wrong_unit`).

    """
    vertices = _checked(vertices, 'vertices')
    if len(vertices) == 0:
        raise InputError('the model is empty; give a triangle mesh or a point cloud with normals')
    _check_size(vertices)
    if faces is not None and len(faces):
        bone = _bone_of_mesh(vertices, _checked_faces(faces, len(vertices)))
    elif normals is not None:
        bone = _bone_of_cloud(vertices, _checked(normals, 'normals'))
    else:
        raise InputError('the model has neither faces nor normals; '
                         'give a triangle mesh or a point cloud with normals')
    _check_size(bone.vertices)
    if bone.notes:
        _log.warning('the bone model was repaired: %s', ' '.join(bone.notes))
    return bone


def _bone_of_mesh(vertices: Array, faces: np.ndarray) -> Bone:
    """Repair a mesh, step by step."""
    notes: list[str] = []
    vertices, faces = mesh_repair.merge_vertices(vertices, faces, notes)
    faces = mesh_repair.drop_bad_faces(vertices, faces, notes)
    if len(faces) == 0:
        raise InputError('no face of the model has an area; export the surface again')
    faces, bodies = mesh_repair.wind_consistently(faces, notes)
    keep = mesh_repair.large_bodies(vertices, faces, bodies, notes)
    faces, bodies = faces[keep], bodies[keep]
    faces = mesh_repair.orient_outward(vertices, faces, bodies, notes)
    faces = faces[mesh_repair.outer_bodies(vertices, faces, bodies, notes)]
    vertices, faces = mesh_repair.drop_unused_vertices(vertices, faces)
    return Bone(vertices, faces.astype(np.int32), None, tuple(notes))


def _bone_of_cloud(points: Array, normals: Array) -> Bone:
    """Check the normals of a cloud and drop repeated points."""
    if normals.shape != points.shape:
        raise InputError(f'the model has {counted(len(points), "point")} but '
                         f'{counted(len(normals), "normal")}; give one normal a point')
    length = np.linalg.norm(normals, axis=1)
    if (length < 1e-6).any():
        raise InputError(f'normal {int(length.argmin())} of the model has no length; '
                         'estimate the normals again')
    notes = []
    if np.abs(length - 1.0).max() > 1e-3:
        notes.append('The normals were scaled to unit length.')
    _, first = np.unique(points, axis=0, return_index=True)
    if len(first) < len(points):
        notes.append(f'Dropped {counted(len(points) - len(first), "repeated point")}.')
    first.sort()
    return Bone(points[first], None, normals[first] / length[first, None], tuple(notes))


def _checked(array: Array, what: str) -> Array:
    """Return ``array`` as finite (n, 3) float64."""
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
    """Return ``faces`` as (m, 3) int64 with every index in range(n)."""
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise InputError(
            'the faces of the model must be rows of three vertex indices; triangulate it first')
    bad = ((faces < 0) | (faces >= n)).any(axis=1)
    if bad.any():
        raise InputError(f'face {int(bad.argmax())} of the model names a vertex that is not there; '
                         f'there are {n} vertices')
    return faces.astype(np.int64)


def _check_size(vertices: Array) -> None:
    """Refuse what is too small or too large for a bone."""
    extent = float(np.ptp(vertices, axis=0).max())
    if not SMALLEST <= extent <= LARGEST:
        given, meant = ('mm', 'm') if extent < SMALLEST else ('m', 'mm')
        raise InputError(f'the model reads as {length(extent)} large, but a bone is '
                         f'{SMALLEST * 1e3:.0f} mm to {LARGEST:.0f} m: its unit is probably '
                         f'{meant}, not {given}', Reason.WRONG_UNIT)
