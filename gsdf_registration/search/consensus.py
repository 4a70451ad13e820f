# SPDX-License-Identifier: Apache-2.0
"""
Sample consensus over patches of points, for recordings with much interference.

Where a large part of the points is on soft tissue, a pose that fits all points moderately attracts
every local solution. A few patches, however, lie on bone only, and the pose that fits them also
fits the rest of the bone exactly: maximum likelihood sample consensus (MLESAC; Torr and Zisserman
2000).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common import rigid
from gsdf_registration.common.downsampling import farthest_point_sample, voxel_downsample
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.search.descent import gauss_newton_steps
from gsdf_registration.search.global_search import VOXEL
from gsdf_registration.search.start_poses import distinct
from gsdf_registration.solver import patch_likelihood

SAMPLES = 150       # of three patches; with 40 % interference one in five is on bone only
PATCHES = 3         # per sample
SEEDS = 24          # of the patches
PATCH_SHARE = 0.08  # of the points in a patch
MIN_PATCH = 8       # points in a patch
POINTS = 300        # from which the patches are drawn
SCALES = np.array([0.003, 0.003, 0.002, 0.002, 0.0015])    # m, of the weights, one step each
POSE_ERROR = 0.00035    # m, of a good pose from so few points
SEPARATION = 0.00025    # m (RMS over the points) between returned poses


def consensus(points: Array, field: Field, T_bone_tracker: Array, neighbours: NDArray[np.int64],
              count: int) -> Array:
    """
    Return distinct poses that each fit a few patches, the most likely over all points first.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : of the bone
    T_bone_tracker : (4, 4) float, initial pose
    neighbours : (n, k) int of the points
    count : int, maximum number of poses

    Returns
    -------
    (m, 4, 4) float, T_bone_tracker each

    """
    sparse = points[voxel_downsample(points, VOXEL)]
    sparse = sparse[farthest_point_sample(sparse, POINTS)]
    seeds = sparse[farthest_point_sample(sparse, SEEDS)]
    size = min(max(MIN_PATCH, int(PATCH_SHARE * len(sparse))), len(sparse))
    patch = cKDTree(sparse).query(seeds, k=size)[1]
    rng = np.random.default_rng(0)      # fixed seed: the same points give the same pose
    samples = [np.unique(patch[rng.permutation(len(patch))[:PATCHES]]) for _ in range(SAMPLES)]
    poses = np.array([_fit(sparse[sample], field, T_bone_tracker) for sample in samples])
    likelihood = [patch_likelihood(field.sample(rigid.transform(T, points))[0], neighbours,
                                   POSE_ERROR) for T in poses]
    poses = poses[np.argsort(likelihood, kind='stable')[::-1]]
    centroid = points.mean(axis=0)
    placed = np.array([rigid.transform(T, centroid) for T in poses])
    return poses[distinct(poses[:, :3, :3], placed, points - centroid, SEPARATION, count)]


def _fit(points: Array, field: Field, T_bone_tracker: Array) -> Array:
    """Return the pose after a few robust steps on a few points."""
    centroid = points.mean(axis=0)
    R = T_bone_tracker[None, :3, :3].copy()
    t = rigid.transform(T_bone_tracker, centroid)[None].copy()
    columns = np.ascontiguousarray((points - centroid).T, dtype=np.float32)
    gauss_newton_steps(field.arrays, True, columns, R, t, SCALES, np.zeros(1))
    return rigid.from_rt(R[0], t[0] - R[0] @ centroid)
