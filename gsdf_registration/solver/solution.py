# SPDX-License-Identifier: Apache-2.0
"""What a local solver returns."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as item
from typing import NamedTuple

from gsdf_registration.common.result import Iteration
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver.model_error import ModelError
from gsdf_registration.solver.touches import NO_TOUCHES


class Estimates(NamedTuple):
    """
    What the mixture estimates besides the pose.

    noise : float, m, standard deviation of a point along the normal
    local_sd : float, m, standard deviation of the mean residuals of neighbours
    inlier_ratio : float in (0, 1), share of the points that are on the bone
    max_local_sd : float, m, upper limit of ``local_sd``
    """

    noise: float
    local_sd: float
    inlier_ratio: float
    max_local_sd: float


@dataclass(frozen=True)
class Solution:
    """
    A local solution.

    T_bone_tracker : (4, 4) float, metres
    correction : (4, 4) float, metres, motion of the bone frame applied after the iterations of the
        mixture: bias correction and model error
    weights : (n,) float in [0, 1], weight of each point
    residuals : (n,) float, metres, signed distance of each point at the pose, less its expected
        bias if the bias correction was applied; NaN where the published method discarded the point
    precision : (n,) float, mean noise over the noise along the normal of each point
    jacobian : (n, 6) float, d residual / d [rotation about the centroid of the points,
        translation], bone axes
    curvature : (n,) float, d(w e)/de, less than the weight, or negative, where the solver is about
        to reject a point
    consistent : whether most points fit within white noise and hardly any lies inside the bone
    score : float, log-likelihood (mixture) or sum of the weights (paper)
    converged : bool
    termination : str, why the solver stopped, for the user
    iterations : int
    touches : (t,) float, relative noise of the last t points, which are touches
    estimates : state to warm-start from; None after the published method
    model_error : the model error that was allowed for; None if none was found or looked for
    history : the iterations, if requested
    """

    T_bone_tracker: Array
    correction: Array
    weights: Array
    residuals: Array
    precision: Array
    jacobian: Array
    curvature: Array
    consistent: bool
    score: float
    converged: bool
    termination: str
    iterations: int
    touches: Array = item(default_factory=lambda: NO_TOUCHES)
    estimates: Estimates | None = None
    model_error: ModelError | None = None
    history: tuple[Iteration, ...] = ()

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key: of two solutions for the same points, the one of higher rank is better."""
        return self.consistent, self.score
