# SPDX-License-Identifier: Apache-2.0
"""
Find the pose without an initial pose, and other poses that fit nearly as well.

The search starts from many poses and refines each by a few Gauss-Newton steps with increasingly
narrow robust weights, at first with few points and the coarse nodes of the field. Only the best
poses proceed to more points and the fine nodes. It runs for all points and for subsets of them:
other objects that were touched could pull the pose away, but some subset is free of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SearchConfig
from gsdf_registration.common.downsampling import (
    farthest_point_sample,
    principal_frame,
    voxel_downsample,
)
from gsdf_registration.common.point_filters import RADIUS
from gsdf_registration.common.result import Cancelled
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.search.descent import gauss_newton_steps, start_costs
from gsdf_registration.search.point_subsets import filter_sparse, local_subsets
from gsdf_registration.search.start_poses import (
    Poses,
    distinct,
    rotated_starts,
    super_fibonacci,
)

# m: starts within this distance converge to the pose; about the distance between adjacent starts
CAPTURE_RANGE = 0.02
# m: one point per voxel is used, and poses that move the points by less are the same pose; above
# the noise of a tracker, below the size of the features of a bone
VOXEL = 0.002
START_POSES = 6         # returned; one of the best few nearly always leads to the pose
MOST_POSES = 100        # that can be returned
START_POINTS = 16       # points by which the starts are ranked
RANKED_STARTS = 4000    # best starts that are refined
CHUNK = 64              # candidates per task: small enough to balance the load and to cancel soon


class Stage(NamedTuple):
    """
    One stage of the search.

    points : number used
    scales : of the weights, one per step, relative to the capture range
    fine : whether the fine nodes are used
    dense : whether sparse points are left out in the first of two rankings
    survivors : maximum number of poses that proceed
    done : share of the whole work done after it
    """

    points: int
    scales: tuple[float, ...]
    fine: bool
    dense: bool
    survivors: int
    done: float


FIRST = Stage(40, (1.0, 0.75, 0.5, 0.35, 0.25), False, True, 400, 0.85)
# The last scale ranks the poses. It is narrow: with a wide scale, a pose that fits all points
# moderately, including interference, would rank above the pose that fits those on the bone exactly.
STAGES = (Stage(100, (0.3, 0.25, 0.2, 0.15, 0.1, 0.075), False, True, 600, 0.95),
          Stage(150, (0.15, 0.1, 0.1, 0.05), True, False, 100, 0.98),
          Stage(400, (0.1, 0.075, 0.05, 0.05), True, False, MOST_POSES, 1.0))


def find_start_poses(points: Array,
                     field: Field,
                     config: SearchConfig,
                     T_bone_tracker: Array | None = None,
                     cancelled: Callable[[], bool] | None = None,
                     progress: Callable[[float], None] | None = None,
                     count: int = START_POSES) -> Array:
    """
    Return distinct poses that fit the points, best first.

    The result moves with the points and does not depend on their order.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame, on strokes
    field : of the bone
    config : SearchConfig
    T_bone_tracker : (4, 4) float, initial pose to search around; None: search everywhere
    cancelled, progress : as in `register`
    count : int, maximum number of poses, up to `MOST_POSES`

    Returns
    -------
    (m, 4, 4) float, T_bone_tracker each

    Raises
    ------
    Cancelled

    """
    chosen = voxel_downsample(points, VOXEL)
    dense = filter_sparse(points, chosen, RADIUS)
    T_principal_tracker = principal_frame(points[chosen])
    points = rigid.transform(T_principal_tracker, points[chosen])
    core, points = points[dense], points[farthest_point_sample(points, STAGES[-1].points)]
    with ThreadPoolExecutor(config.threads or os.cpu_count() or 1) as pool:
        work = _Work(pool, cancelled, progress)
        if T_bone_tracker is None:
            poses = _from_anywhere(work, core, field, config)
        else:
            # unrefined, in case there is much interference, and refined from farther away
            starts = rotated_starts(T_bone_tracker @ rigid.inverse(T_principal_tracker))
            poses = Poses.concatenated([starts, _run_stage(work, FIRST, core, field, starts)])
        # sparse points may be in the air and pull poses that are still far off; but without them,
        # another object that was touched has a larger share of the points
        sets = (core, points) if len(core) < len(chosen) else (core,)
        poses = _alternated([_rank(work, near, points, field, poses, number, len(sets))
                             for number, near in enumerate(sets)], points)
    return np.array([rigid.from_rt(R, t) @ T_principal_tracker
                     for R, t in zip(poses.R[:count], poses.t[:count])])


def _from_anywhere(work: _Work, points: Array, field: Field, config: SearchConfig) -> Poses:
    """Return the survivors of the first stage for all points (n, 3) and for each subset."""
    surface = field.surface_points.astype(np.float64)
    places = surface[farthest_point_sample(surface, config.places)]
    rotations = super_fibonacci(config.rotations)
    return Poses.concatenated(
        work((work.pool.submit(_first_stage, subset, field, rotations, places)
              for subset in local_subsets(points, config.parts)), FIRST.done))


def _first_stage(points: Array, field: Field, rotations: Array, places: Array) -> Poses:
    """Return the survivors of all rotations with the centroid of the points at all places."""
    centroid = points.mean(axis=0)
    points = points - centroid
    cost = np.empty(len(rotations) * len(places))
    start_costs(field.arrays, _columns(points, START_POINTS), rotations, places, CAPTURE_RANGE,
                cost)
    best = np.argsort(cost, kind='stable')[:RANKED_STARTS]
    poses, cost = Poses(rotations[best // len(places)], places[best % len(places)]), cost[best]
    _refine(FIRST, points, field, poses, cost)
    return _survivors(FIRST, points, poses, cost).with_origin(-centroid)


def _rank(work: _Work, near: Array, points: Array, field: Field, poses: Poses, number: int,
          count: int) -> Poses:
    """
    Return the survivors of all `STAGES`, best first.

    near : (k, 3) float, the points of the stages that are marked ``dense``
    number, count : the ranking and how many there are, for the progress
    """
    for stage in STAGES:
        share = (stage.done - FIRST.done) / (1.0 - FIRST.done)
        poses = _run_stage(work, stage._replace(
            done=FIRST.done + (1.0 - FIRST.done) * (number + share) / count),
            near if stage.dense else points, field, poses)
    return poses


def _alternated(ranked: Sequence[Poses], points: Array) -> Poses:
    """Return the distinct poses of several rankings: the best of each, the second of each, ..."""
    places = np.concatenate([np.arange(len(each.R)) for each in ranked])
    poses = Poses.concatenated(ranked).select(np.argsort(places, kind='stable'))
    return poses.select(distinct(*poses, points, VOXEL, MOST_POSES))


def _run_stage(work: _Work, stage: Stage, points: Array, field: Field, poses: Poses) -> Poses:
    """Return the survivors of a stage, best first."""
    R, t, cost = poses.R.copy(), poses.t.copy(), np.empty(len(poses.R))
    chunks = [slice(k, k + CHUNK) for k in range(0, len(cost), CHUNK)]
    work((work.pool.submit(_refine, stage, points, field, Poses(R[k], t[k]), cost[k])
          for k in chunks), stage.done)
    return _survivors(stage, points, Poses(R, t), cost)


def _refine(stage: Stage, points: Array, field: Field, poses: Poses, cost: Array) -> None:
    """Refine poses and fill their cost, in place."""
    gauss_newton_steps(field.arrays, stage.fine, _columns(points, stage.points), poses.R, poses.t,
                       CAPTURE_RANGE * np.array(stage.scales), cost)


def _survivors(stage: Stage, points: Array, poses: Poses, cost: Array) -> Poses:
    """Return the best distinct poses, best first."""
    ranked = poses.select(np.argsort(cost, kind='stable'))
    return ranked.select(distinct(*ranked, points, VOXEL, stage.survivors))


def _columns(points: Array, count: int) -> NDArray[np.float32]:
    """Return at most ``count`` of the points (n, 3) in the layout of the kernels, (3, m)."""
    return np.ascontiguousarray(points[farthest_point_sample(points, count)].T, dtype=np.float32)


class _Work:
    """Run independent tasks on all threads; the number of threads does not change the result."""

    def __init__(self, pool: ThreadPoolExecutor, cancelled: Callable[[], bool] | None,
                 progress: Callable[[float], None] | None) -> None:
        self.pool, self.cancelled, self.progress, self.done = pool, cancelled, progress, 0.0

    def __call__(self, tasks: Iterable[Future], done: float) -> list:
        """Return the results of tasks, after which the share ``done`` of all work is done."""
        tasks = list(tasks)
        step = (done - self.done) / len(tasks)
        results = []
        for task in tasks:
            results.append(task.result())
            if self.cancelled is not None and self.cancelled():
                self.pool.shutdown(cancel_futures=True)
                raise Cancelled
            self.done += step
            if self.progress is not None:
                self.progress(min(self.done, 1.0))
        return results
