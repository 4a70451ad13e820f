# SPDX-License-Identifier: Apache-2.0
"""
Models of a bone as patients have them: segmented from a scan, or with few faces.

The bone itself is known exactly, so the error of the model is. The frame of the bone is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gsdf_registration.common.rigid import Array

SUBDIVISIONS = 3        # of a voxel along each axis, to compute which part of it is bone
SLAB = 1_000_000        # voxels that are sampled at once
MARGIN = 4              # voxels around the bone


@dataclass(frozen=True)
class Scan:
    """
    A scan and its segmentation by a threshold.

    voxel : (x, y, z), m
    blur : m, standard deviation of the point spread function
    noise : standard deviation of a voxel; the contrast between bone and tissue is 1
    level_error : largest error of the threshold, which is 0.5 without error
    smoothing : rounds of volume-preserving smoothing of the surface (Taubin 1995)
    """

    voxel: tuple[float, float, float]
    blur: float
    noise: float
    level_error: float = 0.1
    smoothing: int = 0


CT = Scan((0.0007, 0.0007, 0.0008), 0.0006, 0.05)
CT_THICK_SLICES = Scan((0.0007, 0.0007, 0.0012), 0.0006, 0.05)
MRI = Scan((0.001, 0.001, 0.001), 0.0008, 0.08, smoothing=10)


def segmented(signed_distance: Callable[[Array], Array], bounds: ArrayLike, scan: Scan,
              rng: np.random.Generator) -> tuple[Array, NDArray[np.int64]]:
    """
    Return the surface of a bone that is segmented from a scan.

    The value of a voxel is the part of it that is bone, blurred, with noise. The surface is the
    level set near one half (marching cubes); of several bodies, the largest.

    Parameters
    ----------
    signed_distance : (n, 3) m -> (n,) m, to the bone, negative inside
    bounds : (2, 3) float, m, bounding box of the bone
    scan : Scan
    rng : numpy Generator
        For the position of the voxels, the noise and the error of the threshold.

    Returns
    -------
    vertices : (n, 3) float, m, bone frame
    faces : (m, 3) int, outward

    """
    from skimage.measure import marching_cubes  # a dependency of tests and benchmarks only

    voxel, (low, high) = np.array(scan.voxel), np.asarray(bounds, dtype=np.float64)
    origin = low - (MARGIN + rng.random(3)) * voxel
    shape = tuple(np.ceil((high - origin) / voxel).astype(int) + MARGIN + 1)
    image = _bone_share(signed_distance, origin, voxel, shape)
    image = ndimage.gaussian_filter(image, scan.blur / voxel)
    image += scan.noise * rng.standard_normal(shape, dtype=np.float32)
    level = 0.5 + scan.level_error * rng.uniform(-1.0, 1.0)
    vertices, faces, _, _ = marching_cubes(image, level, spacing=tuple(voxel),
                                           gradient_direction='ascent')
    mesh = trimesh.Trimesh(vertices.astype(np.float64), faces)
    mesh = max(mesh.split(only_watertight=False), key=lambda part: len(part.faces))
    if scan.smoothing:
        trimesh.smoothing.filter_taubin(mesh, iterations=2 * scan.smoothing)
    return np.asarray(mesh.vertices) + origin, np.asarray(mesh.faces, dtype=np.int64)


def decimated(vertices: ArrayLike, faces: ArrayLike,
              count: int) -> tuple[Array, NDArray[np.int64]]:
    """
    Return a surface reduced to ``count`` faces by edge collapses (Garland and Heckbert 1997).

    Parameters
    ----------
    vertices : (n, 3) float, m
    faces : (m, 3) int
    count : int

    """
    from fast_simplification import simplify  # a dependency of benchmarks only

    millimetres = 1e3 * np.asarray(vertices, dtype=np.float64)  # it assumes a size of about 100
    points, triangles = simplify(millimetres, np.asarray(faces), target_count=count)
    return 1e-3 * np.asarray(points, dtype=np.float64), np.asarray(triangles, dtype=np.int64)


def _bone_share(signed_distance: Callable[[Array], Array], origin: Array, voxel: Array,
                shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return which part of each voxel is bone, in [0, 1]."""
    image = np.empty(int(np.prod(shape)), dtype=np.float32)
    half_diagonal = 0.5 * float(np.linalg.norm(voxel))
    steps = (np.arange(SUBDIVISIONS) + 0.5) / SUBDIVISIONS - 0.5
    parts = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3) * voxel
    for first in range(0, len(image), SLAB):
        which = np.arange(first, min(first + SLAB, len(image)))
        middles = origin + np.stack(np.unravel_index(which, shape), axis=1) * voxel
        distance = signed_distance(middles)
        share = (distance < 0.0).astype(np.float32)
        partial = np.abs(distance) < 1.5 * half_diagonal
        inside = signed_distance((middles[partial, None] + parts).reshape(-1, 3)) < 0.0
        share[partial] = inside.reshape(-1, len(parts)).mean(axis=1)
        image[which] = share
    return image.reshape(shape)
