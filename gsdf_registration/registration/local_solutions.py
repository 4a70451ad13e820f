# SPDX-License-Identifier: Apache-2.0
"""
Solve from several start poses.

Of many points, a part finds the local minima, and only the best minima are solved with all points:
more than some thousand points do not change which minimum is the best, but each takes its time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import INLIER_WEIGHT, Cancelled
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.point_selection import evenly_spread
from gsdf_registration.search.consensus import POSE_ERROR, consensus
from gsdf_registration.solver import (
    NO_TOUCHES,
    Solution,
    before,
    nearest_neighbours,
    refine,
    solve,
)

# m: solutions that place the points less than this apart (RMS) are the same local minimum
SAME_MINIMUM = 0.0015
MANY = 3000         # points on strokes of which the minima are found
FINAL = 6           # best minima that are solved with all points
CONSENSUS_ROUNDS = 4        # at most; a round that finds no better solution is the last
# Poses of a round that are solved: the best one may rank low before it is solved
CONSENSUS_POSES = 48
# Share of the points: no other pose can fit better than one that explains this many
MOSTLY_EXPLAINED = 0.9
EXPLAINED_SD = 3.0          # standard deviations of the mean of an explained neighbourhood


def distance_of_poses(points: Array) -> Callable[[Array, Array], float]:
    """
    Return the distance between the images of ``points`` (n, 3) under two motions, m (RMS).

    It follows from the moments of the points, so it takes a few microseconds for any n.
    """
    centroid = points.mean(axis=0)
    arms = points - centroid
    moments = (arms[:, :, None] * arms[:, None, :]).mean(axis=0)

    def distance(T_a: Array, T_b: Array) -> float:
        D = T_a - T_b
        shift = D[:3, :3] @ centroid + D[:3, 3]
        return float(np.sqrt(shift @ shift + ((D[:3, :3] @ moments) * D[:3, :3]).sum()))
    return distance


def solve_all(points: Array,
              field: Field,
              starts: Sequence[Array],
              config: Config,
              history: bool = False,
              cancelled: Callable[[], bool] | None = None,
              touches: Array = NO_TOUCHES,
              evidence: Evidence = Evidence()) -> list[Solution]:
    """
    Return the local solution from each start, and more if the best one does not explain the points.

    Only the first solution of the highest rank has values per point.

    Soft tissue may bias the best solution: then also solve from poses near it that fit a few
    patches. If no solution is consistent, also solve without annealing to the noise, which allows
    for errors of the model and the tracker.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : Field
    starts : sequence of (4, 4) float, T_bone_tracker, metres
    config : Config
    history : bool
        Whether the solutions contain every iteration.
    cancelled : callable, optional
        Called before each solve; if it returns True, `Cancelled` is raised.
    touches : (t,) float
        Relative noise of the last t points, which are touches.
    evidence : Evidence
        What is known of the pose besides the points; its log-likelihood is part of each score.

    Raises
    ------
    Cancelled

    """
    def solve_from(start: Array, **options: Any) -> Solution:
        if cancelled is not None and cancelled():
            raise Cancelled
        return scored(solve(few, field, start, config.solver, history, touches=touches, **options))

    def solve_again(previous: Solution) -> Solution:
        found = refine(points, field, previous, config.solver, reuse_correction=False)
        return scored(replace(found, history=previous.history))

    def scored(found: Solution) -> Solution:
        return replace(
            found, score=found.score + evidence.log_likelihood(found.T_bone_tracker, field))

    part = _part(len(points), touches, config)
    few = points[part]
    with ThreadPoolExecutor(config.search.threads or os.cpu_count() or 1) as pool:
        found = _Solutions()
        found.add(pool.map(solve_from, starts))
        if config.solver.method == 'paper':
            return found.all
        _explain(found, few, touches, field, lambda poses, neighbours: pool.map(
            partial(solve_from, neighbours=neighbours, local_sd=POSE_ERROR), poses))
        if not found.best.consistent:
            found.add(pool.map(partial(solve_from, anneal_to_noise=False), starts))
        if len(few) == len(points):
            return found.all
        first, others = _best_minima(found.all, few)
        final = _Solutions()
        final.add(pool.map(solve_again, first))
    # the poses of the others count as alternatives, but their scores are those of fewer points
    return final.all + [replace(_without_points(each), consistent=False, score=-np.inf)
                        for each in others]


def _explain(found: _Solutions, points: Array, touches: Array, field: Field,
             solve_near: Callable[[Array, NDArray[np.int64]], Iterable[Solution]]) -> None:
    """Add solutions from poses that fit a few patches, while they are better than the best one."""
    for _ in range(CONSENSUS_ROUNDS):
        best = found.best
        neighbours = nearest_neighbours(before(touches, points), field, best.T_bone_tracker)
        if _explained_share(best, neighbours) > MOSTLY_EXPLAINED:
            break
        poses = consensus(points, field, best.T_bone_tracker, neighbours, CONSENSUS_POSES)
        if found.add(solve_near(poses, neighbours)) < (best.consistent, best.score + 1.0):
            break


def _part(count: int, touches: Array, config: Config) -> NDArray[np.int64]:
    """Return which of ``count`` points the minima are found with; the last ones are touches."""
    strokes = count - len(touches)
    if config.solver.method == 'paper':     # as published
        return np.arange(count)
    return np.append(evenly_spread(np.arange(strokes), MANY), np.arange(strokes, count))


def _best_minima(solutions: Sequence[Solution],
                 points: Array) -> tuple[list[Solution], list[Solution]]:
    """Return the best solutions, in distinct minima, and the others."""
    apart, first, others = distance_of_poses(points), list[Solution](), list[Solution]()
    for each in sorted(solutions, key=lambda solution: solution.rank, reverse=True):
        same = any(apart(each.T_bone_tracker, other.T_bone_tracker) <= SAME_MINIMUM
                   for other in first)
        (others if same or len(first) == FINAL else first).append(each)
    return first, others


class _Solutions:
    """
    Solutions of the same points.

    Only the best one keeps its values per point: of many points, hundreds of solutions would take
    hundreds of megabytes.
    """

    def __init__(self) -> None:
        self.all: list[Solution] = []
        self._best = 0

    @property
    def best(self) -> Solution:
        """The first of the solutions of the highest rank."""
        return self.all[self._best]

    def add(self, found: Iterable[Solution]) -> tuple[bool, float]:
        """Add one or more solutions; return the highest rank among them."""
        highest = (False, -np.inf)
        for solution in found:
            highest = max(highest, solution.rank)
            if self.all and not solution.rank > self.best.rank:
                self.all.append(_without_points(solution))
                continue
            if self.all:
                self.all[self._best] = _without_points(self.best)
            self._best = len(self.all)
            self.all.append(solution)
        return highest


def _without_points(solution: Solution) -> Solution:
    """Return the solution without its values per point."""
    none = np.zeros(0)
    return replace(solution, weights=none, residuals=none, precision=none, curvature=none,
                   jacobian=np.zeros((0, 6)))


def _explained_share(solution: Solution, neighbours: NDArray[np.int64]) -> float:
    """Return the share of the points whose local mean is within that of white noise."""
    if not len(neighbours):
        return float((solution.weights > INLIER_WEIGHT).mean())
    e = before(solution.touches, solution.residuals)
    mean = e[neighbours].mean(axis=1)
    noise = 1.4826 * np.median(np.abs(e - mean))
    limit = EXPLAINED_SD * noise / np.sqrt(neighbours.shape[1])
    return float((np.abs(mean) < limit).mean())
