# SPDX-License-Identifier: Apache-2.0
"""Build the gradient-SDF of a bone."""

from __future__ import annotations

import os

import numpy as np

from gsdf_registration.field.field import Field
from gsdf_registration.field.from_cloud import fill_from_cloud
from gsdf_registration.field.from_mesh import fill_from_mesh
from gsdf_registration.field.grid import Grid
from gsdf_registration.mesh.bone import Bone


def build_field(bone: Bone, voxel_size: float = 0.001, threads: int = 0) -> Field:
    """
    Build the gradient-SDF of a bone.

    All blocks with a point within three voxels of the surface have fine nodes, whose distances are
    exact. The distances at the coarse nodes are approximate. The result is bit-identical for any
    number of threads.

    Parameters
    ----------
    bone : Bone
    voxel_size : float, metres
    threads : int, 0: one per core

    Returns
    -------
    Field

    Raises
    ------
    InputError
        If the voxel size is too small for the extent of the bone.

    """
    grid = Grid.around(bone.bounds, float(voxel_size))
    threads = threads or os.cpu_count() or 1
    if bone.faces is None:
        assert bone.normals is not None
        arrays, points, normals = fill_from_cloud(grid, bone.vertices, bone.normals, threads)
        faces = np.empty((0, 3), dtype=np.int32)
    else:
        arrays, points, normals = fill_from_mesh(grid, bone.vertices, bone.faces, threads)
        faces = bone.faces
    return Field(arrays, bone.sha256, bone.bounds, points, normals,
                 bone.vertices.astype(np.float32), faces, bone.notes)
