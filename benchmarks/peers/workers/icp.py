# SPDX-License-Identifier: Apache-2.0
"""Point-to-plane ICPs, each with a decreasing correspondence distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Array = np.ndarray
Model = dict[str, Array]    # vertices, faces; points and normals, dense, in random order
Align = Callable[[Array, float], Array]     # points (n, 3), noise -> motion (4, 4)

TUKEY = 4.685       # standard deviations, for an efficiency of 95 %
MM = 1e3


def reaches(noise: float) -> tuple[float, ...]:
    """Return the maximum correspondence distances of successive runs, m."""
    # landmarks are 4 mm off
    return 0.01, 0.005, TUKEY * noise


def open3d_tukey(model: Model) -> Align:
    """Open3D: Tukey weights; every fourth model point, because each call builds a new tree."""
    import open3d
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    icp = open3d.pipelines.registration

    def cloud(points: Array) -> open3d.geometry.PointCloud:
        return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    target = cloud(model['points'][::4])
    target.normals = open3d.utility.Vector3dVector(model['normals'][::4])
    criteria = icp.ICPConvergenceCriteria(1e-7, 1e-7, 100)

    def align(points: Array, noise: float) -> Array:
        source, motion = cloud(points), np.eye(4)
        for reach in reaches(noise):
            plane = icp.TransformationEstimationPointToPlane(icp.TukeyLoss(reach))
            found = icp.registration_icp(source, target, reach, motion, plane, criteria)
            if not found.fitness:
                break       # no correspondences: keep the previous pose
            motion = found.transformation
        return motion
    return align


def small_gicp_plane(model: Model) -> Align:
    """small_gicp: weights each axis by the normal, therefore the model must be dense."""
    import small_gicp
    target = small_gicp.PointCloud(model['points'])
    tree = small_gicp.KdTree(target)
    small_gicp.estimate_normals(target, tree, 12)

    def align(points: Array, noise: float) -> Array:
        source, motion = small_gicp.PointCloud(points), np.eye(4)
        for reach in reaches(noise):
            motion = small_gicp.align(
                target, source, tree, motion, registration_type='PLANE_ICP',
                max_correspondence_distance=reach, max_iterations=100, rotation_epsilon=1e-5,
                translation_epsilon=1e-6).T_target_source
        return motion
    return align


def meshlib_plane(model: Model) -> Align:
    """MeshLib: on the mesh itself; pairs beyond three times the mean distance are ignored."""
    from meshlib import mrmeshnumpy, mrmeshpy
    target = mrmeshpy.MeshOrPoints(
        mrmeshnumpy.meshFromFacesVerts(model['faces'], MM * model['vertices']))
    fixed = mrmeshpy.AffineXf3f()

    def align(points: Array, noise: float) -> Array:
        source = mrmeshpy.MeshOrPoints(mrmeshnumpy.pointCloudFromPoints(MM * points))
        every = mrmeshpy.VertBitSet()
        every.resize(len(points), True)
        motion = mrmeshpy.AffineXf3f()
        for reach in reaches(noise):
            properties = mrmeshpy.ICPProperties()
            properties.method = mrmeshpy.ICPMethod.PointToPlane
            properties.distThresholdSq = (MM * reach) ** 2
            properties.cosThreshold = -1.0      # the points have no normals
            properties.iterLimit = 100
            icp = mrmeshpy.ICP(source, target, motion, fixed, every)
            icp.setParams(properties)
            motion = icp.calculateTransformation()
        found = np.eye(4)
        found[:3, :3] = [[row.x, row.y, row.z] for row in (motion.A.x, motion.A.y, motion.A.z)]
        found[:3, 3] = motion.b.x / MM, motion.b.y / MM, motion.b.z / MM
        return found
    return align


def fricp_plane(model: Model) -> Align:
    """fricp-cpp: Welsch weights, reduced as in its paper to twice the noise."""
    import fricp_cpp
    target = fricp_cpp.Target(np.ascontiguousarray(MM * model['points'][::4]),
                              np.ascontiguousarray(model['normals'][::4]))

    def align(points: Array, noise: float) -> Array:
        found = np.array(fricp_cpp.registration_icp(
            MM * points, target, MM * reaches(noise)[0], np.eye(4), 'point_to_plane',
            kernel='welsch', nu_begin_k=3.0, nu_end=2.0 * MM * noise, max_total_iteration=400,
            num_threads=1).transformation)
        found[:3, 3] /= MM
        return found
    return align
