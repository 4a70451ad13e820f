# SPDX-License-Identifier: Apache-2.0
"""
The pose with no first guess, and the other poses that fit nearly as well.

Many starts, each pulled in by a few Gauss-Newton steps of ever narrower robust weights, on few
points and the coarse nodes of the field at first; only the best go on to more points and the fine
nodes.  All points are tried, and parts of them alone: other things that were touched would carry
the rest away, but some part is free of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
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
from gsdf_registration.search.descent import descend, glance
from gsdf_registration.search.point_subsets import filter_sparse, local_subsets
from gsdf_registration.search.start_poses import Poses, around, distinct, super_fibonacci

CAPTURE_RANGE = 0.02        # m: a start pose within this distance converges to the pose
# m: of the points in a voxel one is used; poses that move the points less than this are one pose
VOXEL = 0.002
START_POSES = 6     # returned: of the best fits at this accuracy one is the pose, as a rule
GLANCE = 16         # points of the first look at a start
SEEN = 4000         # starts that pass it
CHUNK = 64          # candidates a task: small enough to share evenly and to stop soon


class Stage(NamedTuple):
    """
    One sieve.

    points : looked at
    scales : of the weights, one a step, shares of the reach
    fine : whether the fine nodes are used
    survivors : how many pass
    done : share of the whole work behind it
    """

    points: int
    scales: tuple[float, ...]
    fine: bool
    survivors: int
    done: float


FIRST = Stage(40, (1.0, 0.75, 0.5, 0.35, 0.25), False, 400, 0.85)
# The last scale ranks the poses. It is narrow: at a wide one a pose that fits all points a little,
# whatever else was touched among them, would beat the one that fits those on the bone exactly.
STAGES = (Stage(100, (0.3, 0.25, 0.2, 0.15, 0.1, 0.075), False, 600, 0.95),
          Stage(150, (0.15, 0.1, 0.1, 0.05), True, 100, 0.98),
          Stage(400, (0.1, 0.075, 0.05, 0.05), True, 20, 1.0))


def find_start_poses(points: Array,
                field: Field,
                config: SearchConfig,
                T_bone_tracker: Array | None = None,
                cancelled: Callable[[], bool] | None = None,
                progress: Callable[[float], None] | None = None,
                count: int = START_POSES) -> Array:
    """
    Return the distinct poses that fit, best first.

    A rigid motion of the points moves the answer with it; their order does not matter.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame, on strokes
    field : of the bone
    config : SearchConfig
    T_bone_tracker : (4, 4) float, a first guess to look around; None: everywhere
    cancelled, progress : as in `register`
    count : int, how many poses at most

    Returns
    -------
    (m, 4, 4) float, T_bone_tracker each

    Raises
    ------
    Cancelled

    """
    chosen = voxel_downsample(points, VOXEL)
    dense = filter_sparse(points, chosen, RADIUS)
    T_own_tracker = principal_frame(points[chosen])
    points = rigid.transform(T_own_tracker, points[chosen])
    core, points = points[dense], points[farthest_point_sample(points, STAGES[-1].points)]
    with ThreadPoolExecutor(config.threads or os.cpu_count() or 1) as pool:
        work = _Work(pool, cancelled, progress)
        if T_bone_tracker is None:
            poses = _from_anywhere(work, core, field, config)
        else:
            # as they are, in case much else was touched, and drawn from afar
            near = around(T_bone_tracker @ rigid.inverse(T_own_tracker))
            poses = Poses.joined([near, _sieve(work, FIRST, core, field, config, near)])
        for stage in STAGES:
            poses = _sieve(work, stage, points, field, config, poses)
    return np.array([rigid.from_rt(R, t) @ T_own_tracker
                     for R, t in zip(poses.R[:count], poses.t[:count])])


def _from_anywhere(work: _Work, points: Array, field: Field, config: SearchConfig) -> Poses:
    """Return what passes the first sieve with all points (n, 3) and with each part of them."""
    surface = field.surface_points.astype(np.float64)
    places = surface[farthest_point_sample(surface, config.places)]
    rotations = super_fibonacci(config.rotations)
    return Poses.joined(
        work((work.pool.submit(_first_sieve, part, field, config, rotations, places)
              for part in local_subsets(points, config.parts)), FIRST.done))


def _first_sieve(points: Array, field: Field, config: SearchConfig, rotations: Array,
                 places: Array) -> Poses:
    """Return what passes of every rotation at every place, the points' centroid put there."""
    centre = points.mean(axis=0)
    points = points - centre
    cost = np.empty(len(rotations) * len(places))
    glance(field.arrays, _columns(points, GLANCE), rotations, places, CAPTURE_RANGE, cost)
    seen = np.argsort(cost, kind='stable')[:SEEN]
    poses, cost = Poses(rotations[seen // len(places)], places[seen % len(places)]), cost[seen]
    _descend(FIRST, points, field, config, poses, cost)
    return _best(FIRST, points, config, poses, cost).about(-centre)


def _sieve(work: _Work, stage: Stage, points: Array, field: Field, config: SearchConfig,
           poses: Poses) -> Poses:
    """Return what passes a stage, best first."""
    R, t, cost = poses.R.copy(), poses.t.copy(), np.empty(len(poses.R))
    chunks = [slice(k, k + CHUNK) for k in range(0, len(cost), CHUNK)]
    work((work.pool.submit(_descend, stage, points, field, config, Poses(R[k], t[k]), cost[k])
          for k in chunks), stage.done)
    return _best(stage, points, config, Poses(R, t), cost)


def _descend(stage: Stage, points: Array, field: Field, config: SearchConfig, poses: Poses,
             cost: Array) -> None:
    """Pull poses in and fill their cost, in place."""
    descend(field.arrays, stage.fine, _columns(points, stage.points), poses.R, poses.t,
            CAPTURE_RANGE * np.array(stage.scales), cost)


def _best(stage: Stage, points: Array, config: SearchConfig, poses: Poses, cost: Array) -> Poses:
    """Return the distinct best, best first."""
    ranked = poses.pick(np.argsort(cost, kind='stable'))
    return ranked.pick(distinct(*ranked, points, VOXEL, stage.survivors))


def _columns(points: Array, count: int) -> NDArray[np.float32]:
    """Return some of the points (n, 3), spread over them, as the kernels take them (3, m)."""
    return np.ascontiguousarray(points[farthest_point_sample(points, count)].T, dtype=np.float32)


class _Work:
    """Waits for tasks on all cores; each stands for itself, so threads cannot change the answer."""

    def __init__(self, pool: ThreadPoolExecutor, cancelled: Callable[[], bool] | None,
                 progress: Callable[[float], None] | None) -> None:
        self.pool, self.cancelled, self.progress, self.done = pool, cancelled, progress, 0.0

    def __call__(self, tasks: Iterable[Future], done: float) -> list:
        """Return the results of tasks, after which this share of the whole work is done."""
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
