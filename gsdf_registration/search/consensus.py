# SPDX-License-Identifier: Apache-2.0
"""
Poses that hold for a few small patches of the points and then, it may be, for many more.

Where much of what was touched is soft tissue, the pose that fits all points a little draws every
local solution to it. But some three patches lie on bone alone, and the pose that they give fits
the rest of the bone exactly: maximum likelihood sample consensus (MLESAC; Torr and Zisserman 2000).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common import rigid
from gsdf_registration.common.downsampling import farthest_point_sample, voxel_downsample
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.search.descent import descend
from gsdf_registration.search.global_search import VOXEL
from gsdf_registration.search.start_poses import distinct
from gsdf_registration.solver.mixture import patch_likelihood

DRAWS = 150         # of three patches; with 40 % interference one in five is of bone alone
PATCHES = 3
CENTRES = 24        # that patches are drawn from
SHARE = 0.08        # of the points in a patch
POINTS = 300        # points that the patches are made of
SCALES = np.array([0.003, 0.003, 0.002, 0.002, 0.0015])    # m, of the weights, a step each
POSE_ERROR = 0.00035   # m, by which a good pose from so few points is off
APART = 0.00025     # m (RMS over the points) between poses returned


def consensus(points: Array, field: Field, T_bone_tracker: Array, neighbours: NDArray[np.int64],
              count: int) -> Array:
    """
    Return distinct poses near a first one that hold for a few patches, the most likely first.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : of the bone
    T_bone_tracker : (4, 4) float, where to begin
    neighbours : (n, k) int of the points
    count : int, how many at most

    Returns
    -------
    (m, 4, 4) float, T_bone_tracker each

    """
    sparse = points[voxel_downsample(points, VOXEL)]
    sparse = sparse[farthest_point_sample(sparse, POINTS)]
    centres = sparse[farthest_point_sample(sparse, CENTRES)]
    patch = cKDTree(sparse).query(centres, k=min(max(8, int(SHARE * len(sparse))), len(sparse)))[1]
    rng = np.random.default_rng(0)      # the same draws every time: the same points, the same pose
    drawn = [np.unique(patch[rng.permutation(len(patch))[:PATCHES]]) for _ in range(DRAWS)]
    poses = np.array([_fit(sparse[draw], field, T_bone_tracker) for draw in drawn])
    likelihood = [patch_likelihood(field.sample(rigid.transform(T, points))[0], neighbours,
                                   POSE_ERROR) for T in poses]
    poses = poses[np.argsort(likelihood, kind='stable')[::-1]]
    centre = points.mean(axis=0)
    placed = np.array([rigid.transform(T, centre) for T in poses])
    return poses[distinct(poses[:, :3, :3], placed, points - centre, APART, count)]


def _fit(points: Array, field: Field, T_bone_tracker: Array) -> Array:
    """Return the pose after a few robust steps on a few points."""
    centre = points.mean(axis=0)
    R = T_bone_tracker[None, :3, :3].copy()
    t = rigid.transform(T_bone_tracker, centre)[None].copy()
    columns = np.ascontiguousarray((points - centre).T, dtype=np.float32)
    descend(field.arrays, True, columns, R, t, SCALES, np.zeros(1))
    return rigid.from_rt(R[0], t[0] - R[0] @ centre)
