# SPDX-License-Identifier: Apache-2.0
"""Solvers that run in this process: ours, small_gicp and Open3D, with the model prepared."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field

REACH = 0.01            # m, maximum correspondence distance of the peers: twice the initial error
WARM_TURN, WARM_SHIFT = 0.3, 5e-4   # deg, m, initial error of a warm solve

# points (n, 3), guess T_bone_tracker -> T_bone_tracker, iterations (NaN: unknown), seconds
Aligner = Callable[['Array', 'Array'], tuple['Array', float, float]]


def ours(bone: Field, method: str) -> Aligner:
    """Return a method on the gradient-SDF."""
    from gsdf_registration.common.config import SolverConfig
    from gsdf_registration.solver import solve
    config = SolverConfig(method=method)

    def align(points: Array, guess: Array) -> tuple[Array, float, float]:
        start = perf_counter()
        solution = solve(points, bone, guess, config)
        return solution.T_bone_tracker, solution.iterations, perf_counter() - start
    return align


def warm(bone: Field) -> Aligner:
    """Return the default method started from a displaced solution, as in the live pose."""
    import dataclasses

    import numpy as np

    from gsdf_registration.common import rigid
    from gsdf_registration.common.config import SolverConfig
    from gsdf_registration.solver import nearest_neighbours, refine, solve
    config, rng = SolverConfig(), np.random.default_rng(0)

    def align(points: Array, guess: Array) -> tuple[Array, float, float]:
        neighbours = nearest_neighbours(points, bone, guess)
        known = solve(points, bone, guess, config, neighbours=neighbours)
        axis, direction = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        turn = rigid.from_rt(rigid.rotation_exp(np.radians(WARM_TURN) * axis),
                             WARM_SHIFT * direction)
        about = rigid.from_rt(np.eye(3), points.mean(axis=0))
        moved = known.T_bone_tracker @ about @ turn @ rigid.inverse(about)
        known = dataclasses.replace(known, T_bone_tracker=moved)
        start = perf_counter()
        solution = refine(points, bone, known, config, neighbours)
        return solution.T_bone_tracker, solution.iterations, perf_counter() - start
    return align


def small_gicp(surface: Array, normals: Array) -> Aligner:
    """Return the point-to-plane ICP of small_gicp; cloud, normals and tree are prepared here."""
    import small_gicp as gicp
    target = gicp.PointCloud(surface)
    tree = gicp.KdTree(target, num_threads=1)
    gicp.estimate_normals(target, tree, num_neighbors=12, num_threads=1)

    def align(points: Array, guess: Array) -> tuple[Array, float, float]:
        source = gicp.PointCloud(points)
        start = perf_counter()
        result = gicp.align(target,
                            source,
                            tree,
                            guess,
                            registration_type='PLANE_ICP',
                            num_threads=1,
                            max_iterations=100,
                            max_correspondence_distance=REACH,
                            rotation_epsilon=1e-4,
                            translation_epsilon=1e-5)
        return result.T_target_source, result.iterations, perf_counter() - start
    return align


def open3d(surface: Array, normals: Array) -> Aligner:
    """Return the point-to-plane ICP of Open3D, without the time of the tree it builds per call."""
    import numpy as np
    import open3d as o3d
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    icp = o3d.pipelines.registration
    target = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surface))
    target.normals = o3d.utility.Vector3dVector(normals)
    estimation = icp.TransformationEstimationPointToPlane(icp.TukeyLoss(k=3e-3))
    criteria = icp.ICPConvergenceCriteria(relative_fitness=1e-7,
                                          relative_rmse=1e-7,
                                          max_iteration=100)

    def align(points: Array, guess: Array) -> tuple[Array, float, float]:
        source = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        start = perf_counter()
        o3d.geometry.KDTreeFlann(target)
        ready = perf_counter()
        result = icp.registration_icp(source, target, REACH, guess, estimation, criteria)
        ended = perf_counter()
        return np.asarray(result.transformation), np.nan, max(ended - ready - (ready - start), 0.0)
    return align
