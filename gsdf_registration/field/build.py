# SPDX-License-Identifier: Apache-2.0
"""From a bone to its gradient-SDF: fine blocks in a band round the surface, a coarse grid beyond."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from gsdf_registration.bone import Bone
from gsdf_registration.field.coarse import fill_coarse, mark_cells, spread
from gsdf_registration.field.field import Field
from gsdf_registration.field.nearest import copy_far_faces, fill_blocks
from gsdf_registration.field.sample import CELLS, NODES, FieldArrays
from gsdf_registration.field.surface import sample_surface
from gsdf_registration.field.surfels import Surfels
from gsdf_registration.field.triangles import build_tree
from gsdf_registration.result import InputError
from gsdf_registration.rigid import Array

BAND = 3.0              # half width of the fine band, voxels
MARGIN = 3              # coarse cells round the surface
CHUNK = 256             # blocks filled in one go: few enough to share out, enough not to notice the call
LARGEST_GRID = 2**26    # coarse nodes: 1 GB


def build_field(bone: Bone, voxel_size: float = 0.001, threads: int = 0) -> Field:
    """
    Build the gradient-SDF of a bone.

    The fine nodes, in all blocks with a point within three voxels of the surface, hold exact distances to
    it; the coarse ones beyond may be off by a little.  The bits do not depend on the number of threads.

    Parameters
    ----------
    bone : Bone
    voxel_size : float, metres
    threads : int, 0: one a core

    Returns
    -------
    Field

    Raises
    ------
    InputError
        If the voxel is too small for the size of the bone.

    """
    edge = CELLS * voxel_size
    low = np.floor(bone.bounds[0] / edge).astype(np.int64) - MARGIN
    cells = np.ceil(bone.bounds[1] / edge).astype(np.int64) + MARGIN - low
    if math.prod(int(n) + 1 for n in cells) > LARGEST_GRID:
        raise InputError(f'voxels of {voxel_size * 1e3:g} mm are too small for a bone of '
                         f'{bone.extent * 1e3:.0f} mm; choose a larger voxel size')
    fill = _fill_from_cloud if bone.faces is None else _fill_from_mesh
    arrays = fill(bone, low * edge, tuple(cells.tolist()), voxel_size, threads or (os.cpu_count() or 1))
    points, normals = sample_surface(bone)
    faces = np.empty((0, 3), dtype=np.int32) if bone.faces is None else bone.faces
    return Field(arrays, bone.sha256, bone.bounds, points, normals, bone.vertices.astype(np.float32), faces,
                 bone.notes)


def _reach(voxel: float) -> float:
    """Return how far from the surface the centre of a block with points in the band can be."""
    return (BAND + 0.5 * math.sqrt(3.0) * CELLS) * voxel


def _fill_from_mesh(bone: Bone, origin: Array, cells: tuple[int, ...], voxel: float,
                    threads: int) -> FieldArrays:
    """Fill all nodes with distances to triangles."""
    assert bone.faces is not None
    edge = CELLS * voxel
    tree = build_tree(bone.vertices, bone.faces)
    # Find the blocks
    distance = np.full(cells, np.inf)
    mark_cells(tree, origin, edge, _reach(voxel), distance)
    block_of, where = _number_blocks(distance <= _reach(voxel))
    arrays, blocks, coarse = _allocate(origin, voxel, block_of, len(where))
    # Fill them
    distances = distance[tuple(where.T)]
    nearest = np.full((len(where), 2, 2, 2), -1, dtype=np.int32)

    def fill_chunk(first: int) -> None:
        chunk = slice(first, first + CHUNK)
        fill_blocks(tree, origin, voxel, block_of, where[chunk], distances[chunk],
                    blocks[chunk].reshape(-1, 4), nearest[chunk])

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(fill_chunk, range(0, len(where), CHUNK)))
    copy_far_faces(block_of, where, blocks)
    # Spread what their corners know over the coarse grid
    known = np.full(coarse.shape[:3], -1, dtype=np.int32)
    distance2 = np.full(coarse.shape[:3], np.inf)
    for corner in np.ndindex(2, 2, 2):
        mine = nearest[(slice(None), *corner)] >= 0
        node = tuple((where[mine] + corner).T)
        known[node] = nearest[(mine, *corner)]
        distance2[node] = blocks[(mine, *(CELLS * np.array(corner)), 0)].astype(np.float64) ** 2
    for axis in 2 * (0, 1, 2):
        spread(tree, origin, edge, axis, 0, known.shape[(axis + 1) % 3], known, distance2)
    fill_coarse(tree, origin, edge, known, coarse.reshape(-1, 4))
    return arrays


def _fill_from_cloud(bone: Bone, origin: Array, cells: tuple[int, ...], voxel: float,
                     threads: int) -> FieldArrays:
    """Fill all nodes with distances to surfels."""
    assert bone.normals is not None
    edge = CELLS * voxel
    surfels = Surfels(bone.vertices, bone.normals, threads)
    centres = np.moveaxis(np.indices(cells), 0, -1) + 0.5
    distance = surfels.sample(origin + centres * edge)[..., 0]
    block_of, where = _number_blocks(np.abs(distance) <= _reach(voxel))
    arrays, blocks, coarse = _allocate(origin, voxel, block_of, len(where))
    steps = np.moveaxis(np.indices((NODES, NODES, NODES)), 0, -1)
    for first in range(0, len(where), CHUNK):
        corners = origin + where[first:first + CHUNK, None, None, None] * edge
        blocks[first:first + CHUNK] = surfels.sample(corners + steps * voxel)
    coarse[:] = surfels.sample(origin + np.moveaxis(np.indices(coarse.shape[:3]), 0, -1) * edge)
    return arrays


def _number_blocks(fine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``block_of`` for the cells that are ``fine``, and those cells (n, 3)."""
    where = np.argwhere(fine)
    block_of = np.full(fine.shape, -1, dtype=np.int32)
    block_of[fine] = np.arange(len(where), dtype=np.int32)
    return block_of, where


def _allocate(origin: Array, voxel: float, block_of: np.ndarray,
              n: int) -> tuple[FieldArrays, np.ndarray, np.ndarray]:
    """Return arrays with room for ``n`` blocks, with views of the blocks and of the coarse nodes in them."""
    first_coarse = n * NODES**3
    coarse_shape = tuple(cells + 1 for cells in block_of.shape)
    nodes = np.empty((first_coarse + math.prod(coarse_shape), 4), dtype=np.float32)
    return (FieldArrays(origin, float(voxel), block_of, nodes, first_coarse),
            nodes[:first_coarse].reshape(n, NODES, NODES, NODES, 4),
            nodes[first_coarse:].reshape(*coarse_shape, 4))
