# SPDX-License-Identifier: Apache-2.0
"""Local solutions from several starts, which of them is the pose, how near the next comes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gsdf_registration import rigid
from gsdf_registration.config import Config, SolverConfig
from gsdf_registration.field import Field
from gsdf_registration.rigid import Array
from gsdf_registration.solver import Solution, nearest_neighbours, solve
from gsdf_registration.solver.consensus import SCATTER, consensus

APART = 0.005   # m: solutions that move the points less than this apart (RMS) are one basin


ROUNDS = 4      # of consensus; one that finds nothing better is the last
CANDIDATES = 12     # of a round that are solved to the end
EXPLAINED = 0.9     # share of the points: where so many fit exactly, no other pose can fit better


@dataclass(frozen=True)
class Choice:
    """
    The best solution and what stands against it.

    residuals : (n,) float, metres, of all points on strokes, at the pose
    runner_up_ratio : cost of the best solution elsewhere over the cost of this one; None if no
        other was found
    """

    solution: Solution
    residuals: Array
    runner_up_ratio: float | None


def choose(solutions: Sequence[Solution], points: Array, field: Field,
           config: SolverConfig) -> Choice:
    """
    Return the solution of the highest score, and how near the others come in cost.

    The cost is Geman and McClure's, sum e^2 / (e^2 + c^2) over all points with c the Cauchy scale:
    far points count once.

    Parameters
    ----------
    solutions : one or more, of the same points
    points : (n, 3) float64, metres, tracker frame

    """
    placed = [rigid.transform(solution.T_bone_tracker, points) for solution in solutions]
    residuals = [field.sample(x)[0] for x in placed]
    cost = np.array([(e**2 / (e**2 + config.cauchy_scale**2)).sum() for e in residuals])
    best = int(np.argmax([solution.score for solution in solutions]))
    elsewhere = [c for c, x in zip(cost, placed)
                 if np.sqrt(((x - placed[best]) ** 2).sum(axis=1).mean()) > APART]
    ratio = float(min(elsewhere) / max(cost[best], 1e-12)) if elsewhere else None
    return Choice(solutions[best], residuals[best], ratio)


def solve_all(points: Array, field: Field, starts: Iterable[Array], config: Config,
              history: bool = False) -> list[Solution]:
    """
    Return the local solution from each start, and better ones near the best if not all points fit.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : of the bone
    starts : (4, 4) float each, T_bone_tracker
    config : Config
    history : whether to keep every step

    """
    near = partial(solve, points, field, config=config.solver, history=history)
    with ThreadPoolExecutor(config.search.threads or os.cpu_count() or 1) as pool:
        solutions = list(pool.map(near, starts))
        if config.solver.method == 'paper':
            return solutions
        for _ in range(ROUNDS):
            best = max(solutions, key=lambda solution: solution.score)
            neighbours = nearest_neighbours(points, field, best.T_bone_tracker,
                                            config.solver.neighbours)
            if _explained(best, neighbours) > EXPLAINED:
                break
            poses = consensus(points, field, best.T_bone_tracker, neighbours, config.search.spacing,
                              config.solver.reach, CANDIDATES)
            found = list(pool.map(partial(near, neighbours=neighbours, scatter=SCATTER), poses))
            solutions += found
            if max(solution.score for solution in found) < best.score + 1.0:
                break
    return solutions


def _explained(solution: Solution, neighbours: NDArray[np.int64]) -> float:
    """Return the share of the points whose local mean is within what white noise gives."""
    mean = solution.residuals[neighbours].mean(axis=1)
    noise = 1.4826 * np.median(np.abs(solution.residuals - mean))
    return float((np.abs(mean) < 3.0 * noise / np.sqrt(neighbours.shape[1])).mean())
