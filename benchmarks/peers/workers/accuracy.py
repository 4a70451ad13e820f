# SPDX-License-Identifier: Apache-2.0
"""
Peers that state how accurate a pose is: each returns the motion and its covariance (6, 6).

The covariance is of a rotation and a translation after the motion, in that order, about the origin
of the bone frame. All are given the true noise.
"""

from __future__ import annotations

from collections.abc import Callable

import icp
import numpy as np

Array = np.ndarray
Stated = Callable[[Array, float], tuple[Array, Array]]      # points, noise -> motion, covariance
INLIER = 3.0        # standard deviations of a point about the surface


def open3d_information(model: icp.Model) -> Stated:
    """Open3D: the information matrix of its pose graphs, with unit noise, scaled by the noise."""
    import open3d

    align, registration = icp.open3d_tukey(model), open3d.pipelines.registration
    target = _cloud(model['points'][::4])

    def stated(points: Array, noise: float) -> tuple[Array, Array]:
        motion = align(points, noise)
        information = registration.get_information_matrix_from_point_clouds(
            _cloud(points), target, icp.reaches(noise)[-1], motion)
        return motion, noise**2 * np.linalg.inv(information)
    return stated


def small_gicp_information(model: icp.Model) -> Stated:
    """small_gicp: the Hessian of its last step, scaled by the noise."""
    import small_gicp

    target = small_gicp.PointCloud(model['points'])
    tree = small_gicp.KdTree(target)
    small_gicp.estimate_normals(target, tree, 12)

    def stated(points: Array, noise: float) -> tuple[Array, Array]:
        source, motion = small_gicp.PointCloud(points), np.eye(4)
        for reach in icp.reaches(noise):
            result = small_gicp.align(
                target, source, tree, motion, registration_type='PLANE_ICP',
                max_correspondence_distance=reach, max_iterations=100, rotation_epsilon=1e-5,
                translation_epsilon=1e-6)
            motion = result.T_target_source
        # its steps are applied before the motion
        R, t = motion[:3, :3], motion[:3, 3]
        G = np.block([[R, np.zeros((3, 3))], [_skew(t) @ R, R]])
        return motion, noise**2 * G @ np.linalg.inv(result.H) @ G.T
    return stated


def censi_plane(model: icp.Model) -> Stated:
    """
    Point-to-plane ICP of small_gicp with the closed form of Censi (ICRA 2007).

    H^-1 G cov(z) G^T H^-1 with the second derivatives H by the pose and G by pose and points.
    """
    from scipy.spatial import cKDTree

    align, tree = icp.small_gicp_plane(model), cKDTree(model['points'])

    def stated(points: Array, noise: float) -> tuple[Array, Array]:
        motion = align(points, noise)
        y = points @ motion[:3, :3].T + motion[:3, 3]
        nearest = tree.query(y)[1]
        n = model['normals'][nearest]
        on = np.abs(((y - model['points'][nearest]) * n).sum(axis=1)) < INLIER * noise
        J = np.concatenate([np.cross(y, n), n], axis=1)[on]
        # H = 2 J^T J; a point enters by 2 J n^T, and n^T cov(z) n is the squared noise
        return motion, noise**2 * np.linalg.inv(J.T @ J)
    return stated


def prakhya_point(model: icp.Model) -> Stated:
    """Point-to-point ICP of Open3D with the closed form of Prakhya et al. (MVA 2015)."""
    import open3d
    from scipy.spatial import cKDTree

    registration, dense = open3d.pipelines.registration, model['points'][::4]
    target, tree = _cloud(dense), cKDTree(dense)
    criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, 200)

    def stated(points: Array, noise: float) -> tuple[Array, Array]:
        motion, source = np.eye(4), _cloud(points)
        for reach in (0.01, 0.005, max(0.002, icp.TUKEY * noise)):
            motion = registration.registration_icp(
                source, target, reach, motion,
                registration.TransformationEstimationPointToPoint(), criteria).transformation
        y = points @ motion[:3, :3].T + motion[:3, 3]
        distance, nearest = tree.query(y)
        on = distance < reach
        return motion, _prakhya(y[on], dense[nearest[on]], noise)
    return stated


def surgerycore_tre(model: icp.Model) -> Stated:
    """
    scikit-surgerycore: TRE by the formula of Fitzpatrick et al. (1998) from landmarks.

    The points are four landmarks of the model, the same as touched, then targets; the second result
    is the expected squared error of each target, m^2. The noise is that of a landmark.
    """
    from sksurgerycore.algorithms.errors import compute_tre_from_fle
    from sksurgerycore.algorithms.procrustes import orthogonal_procrustes

    def stated(points: Array, noise: float) -> tuple[Array, Array]:
        fixed, moving, targets = points[:4], points[4:8], points[8:]
        R, t, _ = orthogonal_procrustes(fixed, moving)
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = R, np.ravel(t)
        return motion, np.array([compute_tre_from_fle(fixed, 3.0 * noise**2, target[None])
                                 for target in targets], dtype=float).ravel()
    return stated


def _prakhya(y: Array, q: Array, noise: float) -> Array:
    """Return H^-1 G cov(z) G^T H^-1 of sum |exp(w) y + t - q|^2 by w, t and all y and q."""
    r = y - q
    H, middle, eye = np.zeros((6, 6)), np.zeros((6, 6)), np.eye(3)
    for y_k, r_k in zip(y, r):
        B = np.hstack([-_skew(y_k), eye])
        H += 2.0 * B.T @ B
        outer = np.outer(y_k, r_k)
        H[:3, :3] += outer + outer.T - 2.0 * (r_k @ y_k) * eye
        by_y = 2.0 * np.vstack([_skew(y_k) - _skew(r_k), eye])
        by_q = -2.0 * np.vstack([_skew(y_k), eye])
        middle += by_y @ by_y.T + by_q @ by_q.T
    inverse = np.linalg.inv(H)
    return noise**2 * inverse @ middle @ inverse


def _skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _cloud(points: Array):      # type: ignore[no-untyped-def]
    import open3d
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
