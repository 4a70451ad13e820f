# SPDX-License-Identifier: Apache-2.0
"""Which of several local solutions is the pose, and how near the next-best comes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsdf_registration import rigid
from gsdf_registration.config import SolverConfig
from gsdf_registration.field import Field
from gsdf_registration.rigid import Array
from gsdf_registration.solver import Solution

APART = 0.005   # m: solutions that move the points less than this apart (RMS) are one basin


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
