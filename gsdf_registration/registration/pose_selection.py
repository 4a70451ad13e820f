# SPDX-License-Identifier: Apache-2.0
"""Local solutions from several starts, which of them is the pose, how near the next comes."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, SolverConfig
from gsdf_registration.common.result import Cancelled
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.search.consensus import SCATTER, consensus
from gsdf_registration.solver import Solution, allow_for_model_error, nearest_neighbours, solve
from gsdf_registration.solver.mixture import patch_likelihood

APART = 0.0015  # m: solutions that move the points less than this apart (RMS) are one basin


ROUNDS = 4      # of consensus; one that finds nothing better is the last
CANDIDATES = 48     # of a round that are solved to the end: the right one may rank low before that
EXPLAINED = 0.9     # share of the points: where so many fit exactly, no other pose can fit better


class AlternativePose(NamedTuple):
    """
    Another pose that was found.

    T_bone_tracker : (4, 4) float, metres
    gap : float, by how much it is less likely than the chosen one (natural logarithm)
    cost_ratio : float, Geman and McClure's cost of the points there over that at the chosen one
    """

    T_bone_tracker: Array
    gap: float
    cost_ratio: float


@dataclass(frozen=True)
class SelectedPose:
    """
    The best solution and what stands against it.

    residuals : (n,) float, metres, of all points on strokes, at the pose
    rivals : poses elsewhere, the most likely first
    """

    solution: Solution
    residuals: Array
    rivals: list[AlternativePose]

    @property
    def runner_up_ratio(self) -> float | None:
        """Return the least cost elsewhere over the cost here; None if no other pose was found."""
        return min((rival.cost_ratio for rival in self.rivals), default=None)

    def as_likely(self, min_gap: float) -> list[Array]:
        """Return the poses, T_bone_tracker, less than ``min_gap`` less likely than the chosen."""
        return [rival.T_bone_tracker for rival in self.rivals if rival.gap < min_gap]


def choose(solutions: Sequence[Solution], points: Array, field: Field,
           config: SolverConfig) -> SelectedPose:
    """
    Return the solution of the highest rank, and how near the others come.

    An error of the model is allowed for in it, if one is seen.

    Parameters
    ----------
    solutions : one or more, of the same points
    points : (n, 3) float64, metres, tracker frame

    """
    best = max(solutions, key=lambda solution: solution.rank)
    placed = [rigid.transform(solution.T_bone_tracker, points) for solution in (best, *solutions)]
    residuals = [field.sample(x)[0] for x in placed]
    neighbours = nearest_neighbours(points, field, best.T_bone_tracker)
    scatter = max(_scatter(best, neighbours), 0.01 * field.voxel_size)
    # the same yardstick for all: the likelihood of the local means, the cost that levels off
    likelihood = [patch_likelihood(e, neighbours, scatter) for e in residuals]
    cost = [(e**2 / (e**2 + config.cauchy_scale**2)).sum() for e in residuals]
    found, rivals = [placed[0]], []
    for k in np.argsort(likelihood, kind='stable')[::-1]:
        if all(np.sqrt(((placed[k] - x) ** 2).sum(axis=1).mean()) > APART for x in found):
            found.append(placed[k])
            rivals.append(AlternativePose(solutions[k - 1].T_bone_tracker, likelihood[0] - likelihood[k],
                                float(cost[k] / max(cost[0], 1e-12))))
    best = allow_for_model_error(best, points)
    return SelectedPose(best, field.sample(rigid.transform(best.T_bone_tracker, points))[0], rivals)


def _scatter(solution: Solution, neighbours: NDArray[np.int64]) -> float:
    """Return how far local means scatter by noise alone, or if most do not, by what is there."""
    e = np.nan_to_num(solution.residuals)
    mean, w = e[neighbours].mean(axis=1), solution.weights
    white = 1.4826 * float(np.median(np.abs(e - mean))) / np.sqrt(neighbours.shape[1])
    if solution.exact:
        return white
    return max(white, float(np.sqrt((w * mean**2).sum() / max(w.sum(), 1e-9))))


def solve_all(points: Array,
              field: Field,
              starts: Sequence[Array],
              config: Config,
              history: bool = False,
              cancelled: Callable[[], bool] | None = None) -> list[Solution]:
    """
    Return the local solution from each start, and others where not all points fit the best.

    Where it may be drawn off by soft tissue, those near it that hold for a few patches; where no
    pose fits most points exactly, those that allow for the error of model and tracker.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : of the bone
    starts : (4, 4) float each, T_bone_tracker
    config : Config
    history : whether to keep every step
    cancelled : asked before each solution; a true answer ends the work

    Raises
    ------
    Cancelled

    """
    def near(start: Array, **more: Any) -> Solution:
        if cancelled is not None and cancelled():
            raise Cancelled
        return solve(points, field, start, config.solver, history, **more)

    with ThreadPoolExecutor(config.search.threads or os.cpu_count() or 1) as pool:
        solutions = list(pool.map(near, starts))
        if config.solver.method == 'paper':
            return solutions
        for _ in range(ROUNDS):
            best = max(solutions, key=lambda solution: solution.rank)
            neighbours = nearest_neighbours(points, field, best.T_bone_tracker)
            if _explained(best, neighbours) > EXPLAINED:
                break
            poses = consensus(points, field, best.T_bone_tracker, neighbours, CANDIDATES)
            found = list(pool.map(partial(near, neighbours=neighbours, scatter=SCATTER), poses))
            solutions += found
            if max(solution.rank for solution in found) < (best.exact, best.score + 1.0):
                break
        if not max(solutions, key=lambda solution: solution.rank).exact:
            solutions += pool.map(partial(near, exact=False), starts)
    return solutions


def _explained(solution: Solution, neighbours: NDArray[np.int64]) -> float:
    """Return the share of the points whose local mean is within what white noise gives."""
    mean = solution.residuals[neighbours].mean(axis=1)
    noise = 1.4826 * np.median(np.abs(solution.residuals - mean))
    return float((np.abs(mean) < 3.0 * noise / np.sqrt(neighbours.shape[1])).mean())
