# SPDX-License-Identifier: Apache-2.0
"""Global methods, which need no initial guess; each is followed by an ICP."""

from __future__ import annotations

import numpy as np
from icp import Align, Array, Model, open3d_tukey

SPACING = 0.003     # m, voxel size of the points with features
# stages of the multi-start: candidates, points, correspondence distance (m); then all points
STAGES = ((6000, 30, 0.03), (400, 100, 0.015), (60, 300, 0.008))
FINALISTS = 12


def rigid(R: Array, t: Array) -> Array:
    """Return the transform (4, 4) of x -> R x + t."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = R, np.ravel(t)
    return motion


def moved(motion: Array, points: Array) -> Array:
    """Return points (n, 3) transformed by (4, 4)."""
    return points @ motion[:3, :3].T + motion[:3, 3]


def refined(model: Model) -> Align:
    """Return the ICP that follows; it takes the points after the rough transform."""
    return open3d_tukey(model)


def goicp(model: Model) -> Align:
    """Go-ICP: distance transform with 300 nodes per side, MSE 1e-5 in the unit cube, 50 points."""
    from py_goicp import POINT3D, ROTNODE, TRANSNODE, GoICP
    finish = refined(model)
    cloud = model['points'][:20_000]
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    side = np.ptp(cloud, axis=0).max()
    solver = GoICP()
    target = [POINT3D(*point) for point in ((cloud - middle) / side).tolist()]
    solver.loadModelAndData(len(target), target, 1, target[:1])
    solver.setDTSizeAndFactor(300, 2.0)
    solver.BuildDT()

    def align(points: Array, noise: float) -> Array:
        few = points[np.linspace(0, len(points) - 1, 50).astype(int)]
        centroid = few.mean(axis=0)
        source = [POINT3D(*point) for point in ((few - centroid) / side).tolist()]
        solver.loadModelAndData(len(target), target, len(source), source)
        solver.MSEThresh, solver.doTrim = 1e-5, False
        rotations, places = ROTNODE(), TRANSNODE()
        rotations.a = rotations.b = rotations.c = -np.pi
        rotations.w = 2.0 * np.pi
        places.x = places.y = places.z = -0.5
        places.w = 1.0
        solver.setInitNodeRot(rotations)
        solver.setInitNodeTrans(places)
        solver.Register()
        R = np.array(solver.optimalRotation())
        rough = rigid(R, side * np.array(solver.optimalTranslation()) + middle - R @ centroid)
        return finish(moved(rough, points), noise) @ rough
    return align


def features(cloud: Array) -> tuple[Array, Array]:
    """Return voxel-downsampled points (n, 3) and their FPFH (n, 33), with Open3D."""
    import open3d
    points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud))
    points = points.voxel_down_sample(SPACING)
    near, far = (open3d.geometry.KDTreeSearchParamHybrid(gain * SPACING, most)
                 for gain, most in ((2.0, 30), (5.0, 100)))
    points.estimate_normals(near)
    found = open3d.pipelines.registration.compute_fpfh_feature(points, far)
    return np.asarray(points.points), np.asarray(found.data).T


def teaser(model: Model) -> Align:
    """TEASER++: on mutually nearest FPFH, as in the example of its authors."""
    import open3d
    import teaserpp_python
    finish = refined(model)
    target, target_features = features(model['points'])

    def nearest(a: Array, b: Array) -> Array:
        tree = open3d.core.nns.NearestNeighborSearch(open3d.core.Tensor(b))
        tree.knn_index()
        return tree.knn_search(open3d.core.Tensor(a), 1)[0].numpy().ravel()

    def align(points: Array, noise: float) -> Array:
        source, source_features = features(points)
        forward = nearest(source_features, target_features)
        back = nearest(target_features, source_features)
        mutual = np.flatnonzero(back[forward] == np.arange(len(source)))
        params = teaserpp_python.RobustRegistrationSolver.Params()
        params.cbar2 = 1.0
        params.noise_bound = SPACING
        params.estimate_scaling = False
        params.rotation_gnc_factor = 1.4
        params.rotation_max_iterations = 100
        params.rotation_cost_threshold = 1e-12
        solver = teaserpp_python.RobustRegistrationSolver(params)
        solver.solve(np.ascontiguousarray(source[mutual].T),
                     np.ascontiguousarray(target[forward[mutual]].T))
        solution = solver.getSolution()
        rough = rigid(solution.rotation, solution.translation)
        return finish(moved(rough, points), noise) @ rough
    return align


def kiss_matcher(model: Model) -> Align:
    """KISS-Matcher: in centimetres, because its minimum voxel size is 0.005."""
    import kiss_matcher
    finish = refined(model)
    unit = 100.0
    target = (unit * model['points'][::8]).astype(np.float32)

    def align(points: Array, noise: float) -> Array:
        matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(unit * SPACING))
        solution = matcher.estimate((unit * points).astype(np.float32), target)
        rough = rigid(solution.rotation, np.asarray(solution.translation) / unit)
        return finish(moved(rough, points), noise) @ rough
    return align


def multi_start(model: Model) -> Align:
    """small_gicp from many starts: more points and fewer candidates in each stage."""
    import small_gicp
    finish = refined(model)
    coarse = small_gicp.PointCloud(model['points'][:20_000])
    coarse_tree = small_gicp.KdTree(coarse)
    small_gicp.estimate_normals(coarse, coarse_tree, 8)
    tree = small_gicp.KdTree(model['points'][::8])
    rng = np.random.default_rng(0)
    starts = STAGES[0][0]
    rotations, places = [random_rotation(rng) for _ in range(starts)], model['points'][:starts]

    def best(motions: list[Array], points: Array, reach: float, count: int) -> list[Array]:
        costs = []
        for motion in motions:
            squared = tree.batch_nearest_neighbor_search(moved(motion, points))[1]
            costs.append(np.minimum(squared, reach**2).mean())
        return [motions[k] for k in np.argsort(costs, kind='stable')[:count]]

    def align(points: Array, noise: float) -> Array:
        centroid = points.mean(axis=0)
        motions = [rigid(R, place - R @ centroid) for R, place in zip(rotations, places)]
        following = [count for count, _, _ in STAGES[1:]] + [FINALISTS]
        for (_, count, reach), survivors in zip(STAGES, following):
            few = points[np.linspace(0, len(points) - 1, count).astype(int)]
            source = small_gicp.PointCloud(few)
            motions = [small_gicp.align(coarse, source, coarse_tree, motion,
                                        registration_type='PLANE_ICP', max_iterations=8,
                                        max_correspondence_distance=reach).T_target_source
                       for motion in motions]
            motions = best(motions, few, 0.5 * reach, survivors)
        ends = [finish(moved(motion, points), noise) @ motion for motion in motions]
        return best(ends, points, 5.0 * noise, 1)[0]
    return align


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a uniformly distributed rotation (3, 3)."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q * np.linalg.det(Q)
