# SPDX-License-Identifier: Apache-2.0
"""
What is touched on purpose, the tip at rest.

Landmarks before, verification points after registration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gsdf_registration.config import LandmarksConfig
from gsdf_registration.field import Field
from gsdf_registration.result import InputError, RegistrationResult
from gsdf_registration.rigid import Array, transform
from gsdf_registration.tip import RestingTip


@dataclass(frozen=True)
class Answer:
    """Yes or no, and one plain sentence."""

    success: bool
    message: str


@dataclass(frozen=True)
class CapturedLandmark:
    """A named model point and where the tip rested on it."""

    name: str
    model: Array        # (3,) m, bone frame
    tracker: Array      # (3,) m, frame of the points
    spread_m: float     # root mean square of the samples about their mean
    stamp: float        # s


@dataclass(frozen=True)
class Verification:
    """A point touched on the bone after registration."""

    position: Array     # (3,) m, frame of the points
    distance_m: float   # signed, to the surface as registered at that time; negative: inside
    stamp: float        # s


class Touches:
    """Landmarks and verification points of a session; not thread-safe."""

    def __init__(self, config: LandmarksConfig) -> None:
        self.config = config
        self.tip = RestingTip(config)
        self.landmarks: list[CapturedLandmark] = []
        self.verifications: list[Verification] = []

    def configure(self, config: LandmarksConfig) -> None:
        """Name landmarks and judge rest by these settings; what has been touched stays."""
        self.config = self.tip.config = config

    @property
    def to_come(self) -> list[str]:
        """Names of the landmarks not captured yet."""
        return self.config.names[len(self.landmarks):]

    @property
    def pairs(self) -> tuple[Array, Array] | None:
        """Model and tracker positions, (k, 3) each, m; None while there are fewer than three."""
        if len(self.landmarks) < 3:
            return None
        return (np.array([landmark.model for landmark in self.landmarks]),
                np.array([landmark.tracker for landmark in self.landmarks]))

    def capture(self, now: float | None) -> Answer:
        """Take the resting tip as the next landmark, or say why not."""
        if not self.config.names:
            return Answer(False,
                          'no landmarks are named; set landmarks.names and landmarks.positions')
        if not self.to_come:
            return Answer(
                False, f'all {len(self.config.names)} landmarks are captured; register, or clear '
                'to begin anew')
        name = self.to_come[0]
        try:
            rest = self.tip.rest(now)
        except InputError as refusal:
            return Answer(False, f'landmark "{name}" not captured: {refusal.message}')
        for other in self.landmarks:
            if np.linalg.norm(rest.position - other.tracker) <= self.config.radius:
                return Answer(False, f'the tip is still at landmark "{other.name}"; touch "{name}"')
        row = 3 * len(self.landmarks)
        model = np.array(self.config.positions[row:row + 3])
        self.landmarks.append(
            CapturedLandmark(name, model, rest.position, rest.spread_rms, rest.stamp))
        todo = f'next is "{self.to_come[0]}"' if self.to_come else 'that was the last one'
        return Answer(True, f'landmark "{name}" captured from {rest.samples} samples, spread '
                      f'{1e3 * rest.spread_rms:.2f} mm RMS; {todo}')

    def verify(self, field: Field, pose: RegistrationResult, limit: float,
               now: float | None) -> Answer:
        """Measure how far the resting tip is from the registered surface against ``limit``, m."""
        try:
            rest = self.tip.rest(now)
        except InputError as refusal:
            return Answer(False, f'not verified: {refusal.message}')
        assert pose.T_bone_tracker is not None
        distance = float(field.sample(transform(pose.T_bone_tracker, rest.position)[None])[0][0])
        self.verifications.append(Verification(rest.position, distance, rest.stamp))
        good = abs(distance) <= limit
        side, verdict = 'inside' if distance < 0.0 else 'outside', 'within' if good else 'beyond'
        return Answer(
            good, f'the tip is {1e3 * abs(distance):.1f} mm {side} the registered surface, '
            f'{verdict} the {1e3 * limit:.1f} mm allowed')
