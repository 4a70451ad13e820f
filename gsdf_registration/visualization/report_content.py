# SPDX-License-Identifier: Apache-2.0
"""What a report shows: a registration with everything that is known of it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as item
from pathlib import Path

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.result import INLIER_WEIGHT, Reason, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.field import Field


@dataclass(frozen=True)
class VerificationPoint:
    """
    A place that was touched after the registration.

    name : str
    position : (3,) float, m, tracker frame
    distance_m : float, m, signed, to the registered surface
    stamp : float, s
    moved_m : float, m, since the place was first touched; None: first touch
    """

    name: str
    position: Array
    distance_m: float
    stamp: float
    moved_m: float | None = None


@dataclass(frozen=True)
class ReportContent:
    """
    The contents of a report.

    title : what was registered, in a few words
    result : accepted or refused
    config : the settings of the registration
    field : of the bone, for the tip of the probe; None if it could not be built
    points : n points in the order of ``result.residuals_m``; without stamps those of `untimed`
    timed : whether the points have stamps and strokes
    landmarks : those that were touched
    landmark_stamps : s, when; empty if it is not known
    verifications : of VerificationPoint
    case, date : label of the case and date of the recording or registration; empty if not known
    axes : of the model, 'lps' or 'ras', for the letters A/P/L/R/S/I
    about : rows of the table: inputs, their hashes, times
    """

    title: str
    result: RegistrationResult
    config: Config
    field: Field | None
    points: Points
    timed: bool = True
    landmarks: Landmarks = NO_LANDMARKS
    landmark_stamps: Sequence[float] = ()
    verifications: Sequence[VerificationPoint] = ()
    case: str = ''
    date: str = ''
    axes: str = 'lps'
    about: Mapping[str, str] = item(default_factory=dict)

    @property
    def pose(self) -> Array | None:
        """The pose to draw, T_tracker_bone (4, 4), m: that of a refusal is shown as rejected."""
        considered = self.result.considered
        if self.result.T_tracker_bone is not None or considered is None:
            return self.result.T_tracker_bone
        return considered.T_tracker_bone

    @property
    def covariance(self) -> Array | None:
        """The covariance, if it describes the error: not that of a wrong or ambiguous pose."""
        considered = self.result.considered
        if self.result.reason is Reason.UNDER_CONSTRAINED and considered is not None:
            return considered.covariance
        return self.result.covariance

    @property
    def poses(self) -> list[Array]:
        """The poses to draw, T_tracker_bone (4, 4), m: `pose` and its rivals; often one."""
        considered = self.result.considered
        if self.pose is None:
            return []
        return [self.pose, *(considered.rivals if considered and not self.result.success else ())]

    @property
    def residuals(self) -> Array:
        """Signed distances of the points to the surface at `pose` (n,), m; NaN: not used."""
        known = self.result.residuals_m
        return np.full(len(self.points.positions), np.nan) if known is None else known

    @property
    def weights(self) -> Array:
        """Weights of the points (n,); 0 if they are not known."""
        known = self.result.weights
        return np.zeros(len(self.points.positions)) if known is None else known

    @property
    def inlier(self) -> np.ndarray:
        """Whether each point lies on the bone, (n,) bool."""
        return np.isfinite(self.residuals) & (self.weights > INLIER_WEIGHT)

    def on_bone(self, positions: Array, pose: Array) -> Array:
        """Return where the tip touches the bone (n, 3), m, bone frame, at ``pose``."""
        assert self.field is not None
        return self.field.contacts_at(pose, positions)

    @property
    def side(self) -> str:
        """The side of the bone if the label of the segmentation or the file name states it."""
        for name in (self.config.model.label, Path(self.config.model.path).stem):
            words = set(re.split('[^a-z]+', name.lower())) & {'left', 'right'}
            if len(words) == 1:
                return words.pop()
        return ''
