# SPDX-License-Identifier: Apache-2.0
"""
The pose with no first guess, and the other poses that fit nearly as well.

Many starts, each pulled in by a few Gauss-Newton steps of ever narrower robust weights, on few
points and the coarse nodes of the field at first; only the best go on to more points and the fine
ones.  All points are tried, and parts of them alone: what else was touched lies somewhere, and some
part is free of it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration import rigid
from gsdf_registration.config import SearchConfig
from gsdf_registration.density import crowded, own_axes, spread_sample, thinned
from gsdf_registration.descent import descend, glance
from gsdf_registration.field import Field
from gsdf_registration.field.jit import compiled
from gsdf_registration.result import Reason, Refusal
from gsdf_registration.rigid import Array
from gsdf_registration.starts import around, super_fibonacci

NEAR = 0.2          # share of the points that make a part
AWAY = 0.4          # share that is left out of one
LEAST = 20          # points in a part, if there are so many
GLANCE = 16         # points of the first look at a start
SEEN = 4000         # starts that pass it
CHUNK = 64          # candidates a task: small enough to share evenly and to stop soon


class Stage(NamedTuple):
    """One sieve: points used, scale of each step (share of the reach), the field, how many pass."""

    points: int
    scales: tuple[float, ...]
    fine: bool
    survivors: int


FIRST = Stage(40, (1.0, 0.75, 0.5, 0.35, 0.25), False, 400)
STAGES = (Stage(100, (0.3, 0.25, 0.2, 0.15, 0.1, 0.075), False, 600),
          Stage(150, (0.15, 0.1, 0.1, 0.05), True, 100),
          Stage(400, (0.1, 0.075, 0.05, 0.05), True, 20))


class Poses(NamedTuple):
    """Candidates: rotations R (m, 3, 3), and t (m, 3), m, where the points' centroid comes."""

    R: Array
    t: Array

    def pick(self, which: NDArray[np.int64] | slice) -> Poses:
        """Return some of them, copied."""
        return Poses(self.R[which].copy(), self.t[which].copy())

    def about(self, centre: Array) -> Poses:
        """Return them with t where ``centre`` (3,) comes instead."""
        return Poses(self.R, self.t + self.R @ centre)


def find_basins(points: Array,
                field: Field,
                config: SearchConfig,
                T_bone_tracker: Array | None = None,
                cancelled: Callable[[], bool] | None = None,
                progress: Callable[[float], None] | None = None) -> Array:
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

    Returns
    -------
    (m, 4, 4) float, T_bone_tracker each

    Raises
    ------
    Refusal
        If cancelled.

    """
    chosen = thinned(points, config.spacing)
    dense = crowded(points, chosen, config.radius)
    T_own_tracker = own_axes(points[chosen])
    points = rigid.transform(T_own_tracker, points[chosen])
    core, points = points[dense], points[spread_sample(points, STAGES[-1].points)]
    with ThreadPoolExecutor(config.threads or os.cpu_count() or 1) as pool:
        work = _Work(pool, cancelled, progress, len(STAGES)
                     + (0 if T_bone_tracker is not None else 1 + config.parts))
        if T_bone_tracker is None:
            poses = _from_anywhere(work, core, field, config)
        else:
            poses = Poses(*around(T_bone_tracker @ rigid.inverse(T_own_tracker)))
        for stage in STAGES:
            poses = _sieve(work, stage, points, field, config, poses)
    return np.array([rigid.from_rt(R, t) @ T_own_tracker for R, t in zip(*poses)])


def parts(points: Array, count: int) -> list[Array]:
    """
    Return all points and, round each of ``count`` places, the near ones and all but the near ones.

    Where one other thing was touched some place lies on it; where there are several some place lies
    apart from them.
    """
    near = max(round(NEAR * len(points)), LEAST)
    away = max(min(round(AWAY * len(points)), len(points) - LEAST), 0)
    found = [points]
    for seed in spread_sample(points, count):
        nearest = np.argsort(((points - points[seed])**2).sum(axis=1), kind='stable')
        found += [points[nearest[:near]], points[nearest[away:]]]
    return found


def _from_anywhere(work: _Work, points: Array, field: Field, config: SearchConfig) -> Poses:
    """Return what passes the first sieve with all points and with each part of them alone."""
    surface = field.surface_points.astype(np.float64)
    places = surface[spread_sample(surface, config.places)]
    rotations = super_fibonacci(config.rotations)
    found = work(
        work.pool.submit(_first_sieve, part, field, config, rotations, places)
        for part in parts(points, config.parts))
    return Poses(np.concatenate([poses.R for poses in found]),
                 np.concatenate([poses.t for poses in found]))


def _first_sieve(part: Array, field: Field, config: SearchConfig, rotations: Array,
                 places: Array) -> Poses:
    """Return the poses that fit some of the points (n, 3), of every rotation at every place."""
    middle = part.mean(axis=0)
    part = part - middle
    cost = np.empty(len(rotations) * len(places))
    glance(field.arrays, _columns(part, GLANCE), rotations, places, config.reach, cost)
    seen = np.argsort(cost, kind='stable')[:SEEN]
    poses = Poses(rotations[seen // len(places)], places[seen % len(places)])
    cost = cost[seen]
    _descend(FIRST, part, field, config, poses, cost)
    return _best(FIRST, part, config, poses, cost).about(-middle)


def _sieve(work: _Work, stage: Stage, points: Array, field: Field, config: SearchConfig,
           poses: Poses) -> Poses:
    """Return the poses that pass a stage, best first; in place until then."""
    cost = np.full(len(poses.R), np.inf)
    chunks = [slice(k, k + CHUNK) for k in range(0, len(cost), CHUNK)]
    work([
        work.pool.submit(_descend, stage, points, field, config, Poses(poses.R[k], poses.t[k]),
                         cost[k]) for k in chunks
    ])
    return _best(stage, points, config, poses, cost)


def _descend(stage: Stage, points: Array, field: Field, config: SearchConfig, poses: Poses,
             cost: Array) -> None:
    """Pull poses in and fill their cost, in place."""
    descend(field.arrays, stage.fine, _columns(points, stage.points), poses.R, poses.t,
            config.reach * np.array(stage.scales), cost)


def _best(stage: Stage, points: Array, config: SearchConfig, poses: Poses, cost: Array) -> Poses:
    """Return the distinct best poses, best first."""
    poses = poses.pick(np.argsort(cost, kind='stable'))
    return poses.pick(distinct(poses.R, poses.t, points, config.spacing, stage.survivors))


def _columns(points: Array, count: int) -> NDArray[np.float32]:
    return np.ascontiguousarray(points[spread_sample(points, count)].T, dtype=np.float32)


class _Work:
    """Waits for tasks on all cores; each stands for itself, so threads cannot change the answer."""

    def __init__(self, pool: ThreadPoolExecutor, cancelled: Callable[[], bool] | None,
                 progress: Callable[[float], None] | None, stages: int) -> None:
        self.pool, self.cancelled, self.progress = pool, cancelled, progress
        self.stages, self.done = stages, 0

    def __call__(self, tasks: Iterable[Future]) -> list:
        """Return the results of tasks."""
        results = []
        for task in list(tasks):
            results.append(task.result())
            if self.cancelled is not None and self.cancelled():
                self.pool.shutdown(cancel_futures=True)
                raise Refusal(Reason.NOT_CONVERGED,
                              'the registration was cancelled; the points are kept')
        self.done += 1
        if self.progress is not None:
            self.progress(self.done / self.stages)
        return results


def distinct(R: Array, t: Array, points: Array, separation: float, count: int) -> NDArray[np.int64]:
    """Return the first ``count`` poses that move points ``separation`` (RMS) or more apart."""
    # the RMS distance of two poses over the points is a norm of [R, t]: embed them, then compare
    _, spread, axes = np.linalg.svd(points, full_matrices=False)
    embedded = np.concatenate(
        [(R @ (axes.T * spread / np.sqrt(len(points)))).reshape(len(R), -1), t], axis=1)
    return _distinct(embedded, separation**2, count)


@compiled
def _distinct(x, separation2, count):
    """Return the first ``count`` rows of ``x``, no two of them nearer than sqrt(separation2)."""
    chosen = np.zeros(min(count, len(x)), np.int64)
    m = 0
    for i in range(len(x)):
        new = True
        for j in range(m):
            squared = 0.0
            for a in range(x.shape[1]):
                squared += (x[i, a] - x[chosen[j], a]) ** 2
            if squared < separation2:
                new = False
                break
        if new:
            chosen[m] = i
            m += 1
            if m == len(chosen):
                break
    return chosen[:m]
