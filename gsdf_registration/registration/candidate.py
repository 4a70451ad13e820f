# SPDX-License-Identifier: Apache-2.0
"""A candidate pose and its predicted accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as item

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import (
    INLIER_WEIGHT,
    Reason,
    RegistrationResult,
    WeakestDirection,
    Zone,
)
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence
from gsdf_registration.registration.landmarks import named_points
from gsdf_registration.registration.pose_selection import SelectedPose
from gsdf_registration.registration.weakest_direction import weakest_direction
from gsdf_registration.registration.zone import ErrorMap, find_zone, map_error
from gsdf_registration.solver import Solution


@dataclass(frozen=True)
class Candidate:
    """
    A pose that the pipeline found, before it is accepted or rejected.

    selected : SelectedPose
    confidence : Confidence, or None if the points do not constrain the pose; then the next four
        are empty
    errors : ErrorMap, the error to expect all over the bone
    predicted_tre_m, zone, weakest_direction : as in `RegistrationResult`
    timing_s : of the stages `search` and `solve`
    """

    selected: SelectedPose
    confidence: Confidence | None
    errors: ErrorMap | None = None
    predicted_tre_m: dict[str, float] = item(default_factory=dict)
    zone: Zone | None = None
    weakest_direction: WeakestDirection | None = None
    timing_s: dict[str, float] = item(default_factory=dict)

    @property
    def solution(self) -> Solution:
        """The selected solution."""
        return self.selected.solution

    @property
    def inlier(self) -> NDArray[np.bool_]:
        """Whether each of the points used lies on the bone, (n,)."""
        return np.asarray(self.solution.weights > INLIER_WEIGHT)

    @property
    def inliers(self) -> int:
        """Number of points on the bone."""
        return int(self.inlier.sum())

    @property
    def used(self) -> int:
        """Number of points used."""
        return len(self.solution.weights)

    def to_result(self, reason: Reason, message: str, rows: NDArray[np.int64],
                  received: int) -> RegistrationResult:
        """
        Return the result of a registration, with the pose only if ``reason`` is `CONVERGED`.

        Parameters
        ----------
        reason : Reason
        message : str
        rows : (u,) int
            Which of the points passed to the registration were used; the residuals of the others
            are NaN and their weights 0.
        received : int
            Number of points passed to the registration.

        """
        T_tracker_bone = covariance = None
        if reason is Reason.CONVERGED:
            assert self.confidence is not None
            T_tracker_bone = rigid.inverse(self.solution.T_bone_tracker)
            covariance = self.confidence.pose_covariance(T_tracker_bone)
        residuals, weights = np.full(received, np.nan), np.zeros(received)
        residuals[rows], weights[rows] = self.selected.residuals, self.solution.weights
        return RegistrationResult(
            reason, message, T_tracker_bone, covariance,
            received=received, used=self.used, inliers=self.inliers,
            sigma_m=None if self.confidence is None else self.confidence.sigma,
            residual_rms_m=(rigid.rms(self.selected.residuals[self.inlier])
                            if self.inliers else None),
            predicted_tre_m=self.predicted_tre_m, zone=self.zone,
            weakest_direction=self.weakest_direction, landmarks=self.selected.landmarks,
            runner_up_ratio=self.selected.runner_up_ratio, iterations=self.solution.iterations,
            timing_s=self.timing_s, residuals_m=residuals, weights=weights,
            history=self.solution.history)


def assess_candidate(selected: SelectedPose, confidence: Confidence | None, points: Array,
                     field: Field, config: Config,
                     timing_s: dict[str, float] | None = None) -> Candidate:
    """
    Return the candidate of a selected pose.

    Parameters
    ----------
    selected : SelectedPose
    confidence : Confidence
        Of its solution; None if the points do not constrain the pose.
    points : (n, 3) float64, metres, tracker frame
        The points used.
    field : Field
    config : Config
    timing_s : dict, optional
        Of the stages `search` and `solve`.

    """
    if confidence is None:
        return Candidate(selected, None, timing_s=timing_s or {})
    surface = field.surface_points.astype(np.float64)
    surface_tre = confidence.predicted_tre(surface)
    target_tre = confidence.predicted_tre(np.reshape(config.targets.positions, (-1, 3)))
    predicted_tre_m = {**dict(zip(config.targets.names, target_tre.tolist())),
                       'rms': rigid.rms(surface_tre), 'max': float(surface_tre.max())}
    touched = rigid.transform(selected.solution.T_bone_tracker, points)
    outward = field.sample(touched)[1].mean(axis=0)
    weakest = weakest_direction(confidence, surface, touched, outward, named_points(config))
    on_bone = touched[selected.solution.weights > INLIER_WEIGHT]
    errors = map_error(confidence, surface, on_bone if len(on_bone) else touched, config)
    return Candidate(selected, confidence, errors, predicted_tre_m,
                     find_zone(errors, config.limits.max_error), weakest, timing_s or {})
