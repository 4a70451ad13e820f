# SPDX-License-Identifier: Apache-2.0
"""Estimate the pose from a first guess near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gsdf_registration import rigid
from gsdf_registration.config import SolverConfig
from gsdf_registration.field import Field
from gsdf_registration.result import Iteration
from gsdf_registration.rigid import Array
from gsdf_registration.solver import gauss_newton
from gsdf_registration.solver.paper import algorithm_1


@dataclass(frozen=True)
class Solution:
    """
    Where a solver ended, and why.

    T_bone_tracker : (4, 4) float, metres
    weights : (n,) float in [0, 1], how much each point bears
    residuals : (n,) float, metres, signed distance of each point at the pose; NaN where it was discarded before
    jacobian : (n, 6) float, d residual / d [rotation about the centroid of the points, translation], bone axes
    curvature : (n,) float, d(w e)/de: below the weight where a point is about to be given up
    sigma : float, metres, noise of a point along the surface normal
    settled : bool, whether the weights settled
    termination : str, why it ended, in words
    iterations : int
    history : the steps, on request
    """

    T_bone_tracker: Array
    weights: Array
    residuals: Array
    jacobian: Array
    curvature: Array
    sigma: float
    settled: bool
    termination: str
    iterations: int
    history: tuple[Iteration, ...] = ()


def solve(points: Array, field: Field, T_bone_tracker: Array, config: SolverConfig,
          history: bool = False) -> Solution:
    """
    Return the local solution from a first guess.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    field : of the bone
    T_bone_tracker : (4, 4) float, first guess
    config : method and its settings
    history : whether to return every step

    """
    centre = points.mean(axis=0)
    centred = np.ascontiguousarray(points - centre)
    R = np.ascontiguousarray(T_bone_tracker[:3, :3])
    t = rigid.transform(T_bone_tracker, centre)
    n = len(points)
    keep, weight = np.ones(n, dtype=np.bool_), np.zeros(n)
    e, J = np.full(n, np.nan), np.zeros((n, 6))
    steps = gauss_newton.empty_history(config.max_iterations)
    ended, iterations = algorithm_1(field.arrays, centred, R, t, keep, weight, e, J, steps, config.cauchy_scale,
                                    config.discard_below, config.weight_tolerance, config.hold)
    T = rigid.orthonormalized(rigid.from_rt(R, t - R @ centre))
    e[~keep] = np.nan
    return Solution(T, weight, e, J, curvature=np.where(keep, weight * (2.0 * weight - 1.0), 0.0),
                    sigma=1.4826 * float(np.median(np.abs(e[keep]))) if keep.any() else float('nan'),
                    settled=ended == gauss_newton.SETTLED, termination=gauss_newton.TERMINATION[ended], iterations=iterations,
                    history=tuple(Iteration(*row[:3], int(row[3])) for row in steps[:iterations]) if history else ())
