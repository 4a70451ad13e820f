# SPDX-License-Identifier: Apache-2.0
"""
Find out whether the points lie on the bone moved outward or inward by a constant distance.

That is so if the radius of the ball tip is not the one in the settings, if the tip is wrong along
the probe, or if cartilage covers the bone. The distance is estimated with the pose, as a seventh
unknown: residual SDF - radius - offset. It explains the residuals only if the points then fit as
those of the right bone do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import INLIER_WEIGHT
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence, assess_at
from gsdf_registration.solver import Solution, solve

# m: a smaller offset may come from a segmentation, and the error of the model allows for it
MIN_OFFSET = 0.0003
MAX_OFFSET = 0.004      # m: a larger one is no ball tip and no cartilage
PRECISE = 4.0           # standard deviations that the offset must differ from zero
ROUNDS = 8              # of estimating the offset at the pose, and the pose at the offset
STEP = 0.001            # m, largest change of the offset in a round
CONVERGED = 2e-5        # m, change of the offset in the last round
# share of the points that must lie on the moved bone, and correlation of their residuals
FITTING_INLIERS, FITTING_CORRELATION = 0.9, 1.3


class SurfaceOffset(NamedTuple):
    """
    The points lie on the bone moved outward.

    distance : float, m, beyond the radius of the tip in the settings; negative: inward
    sd : float, m, its standard deviation
    """

    distance: float
    sd: float

    @property
    def sentence(self) -> str:
        """What it means and what to check."""
        side = 'outside' if self.distance > 0.0 else 'inside'
        cartilage = ', or is it cartilage?' if self.distance > 0.0 else ''
        return (f'the points lie {1e3 * abs(self.distance):.1f} mm {side} the bone on average: '
                f'check probe.tip_radius and the tip{cartilage}')


def find_offset(solution: Solution, points: Array, field: Field,
                config: Config) -> SurfaceOffset | None:
    """
    Return the offset that explains the residuals of a solution; None if none does.

    It takes about eight times as long as a solve.

    Parameters
    ----------
    solution : of the mixture, of these points
    points : (n, 3) float64, metres, tracker frame
    field : Field
        For the tip of the settings.
    config : Config

    """
    def at(offset: float, T_bone_tracker: Array) -> tuple[Field, Solution]:
        moved = field.moved_outward(field.tip_radius + offset)
        return moved, solve(points, moved, T_bone_tracker, config.solver, touches=solution.touches)

    offset, change = 0.0, np.inf
    moved, found = at(0.0, solution.T_bone_tracker)
    likelihood = found.score
    for _ in range(ROUNDS):
        step, variance = _step(found)
        change = float(np.clip(step, -STEP, STEP))
        if abs(change) < CONVERGED:
            break
        offset += change
        if abs(offset) > MAX_OFFSET:
            return None
        moved, found = at(offset, found.T_bone_tracker)
    confidence = assess_at(found, points, moved, config.probe.tip_error)
    if confidence is None or not _fits(found, confidence):
        return None
    sd = confidence.sigma * float(np.sqrt(variance * confidence.residual_correlation))
    if (abs(offset) < max(MIN_OFFSET, PRECISE * sd)
            or found.score - likelihood < config.limits.min_gap):
        return None
    return SurfaceOffset(offset, sd)


def _fits(solution: Solution, confidence: Confidence) -> bool:
    """Return whether the points fit as those of the right bone do."""
    return bool(np.mean(solution.weights > INLIER_WEIGHT) >= FITTING_INLIERS
                and confidence.residual_correlation <= FITTING_CORRELATION)


def _step(solution: Solution) -> tuple[float, float]:
    """Return the change of the offset that fits best together with the pose, and its variance."""
    weight = solution.weights * solution.precision**2
    J = np.column_stack([solution.jacobian, -np.ones(len(weight))])
    # rotations in units of a rotation that moves the points about as far as a translation
    J[:, :3] /= np.sqrt((J[:, :3]**2).sum(axis=1).mean()) + 1e-12
    normal = (J.T * weight) @ J + 1e-9 * weight.sum() * np.eye(7)
    inverse = np.linalg.pinv(normal, hermitian=True)
    return float(-(inverse @ (J.T @ (weight * np.nan_to_num(solution.residuals))))[6]), float(
        inverse[6, 6])
