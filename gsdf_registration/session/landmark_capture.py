# SPDX-License-Identifier: Apache-2.0
"""
What is touched on purpose, the tip at rest.

Landmarks before, verification points after registration.  Neither is used in the fit: a landmark is
touched where it can be reached, over tissue and some millimetres off, and a verification point says
something only if the pose was found without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.config import LandmarksConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.registration.landmarks import disagreement
from gsdf_registration.session.stationary_tip import StationaryTip, StationaryTipDetector
from gsdf_registration.session.verification import Verification, distance_to, sentence, verified

FAR = 0.015     # m; a landmark touched this far from its place was another one


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


class LandmarkCapture:
    """Landmarks and verification points of a session; not thread-safe."""

    def __init__(self, config: LandmarksConfig) -> None:
        self.config = config
        self.tip = StationaryTipDetector(config)
        self.landmarks: list[CapturedLandmark] = []
        self.verifications: list[Verification] = []

    def check(self, config: LandmarksConfig) -> None:
        """Raise `InputError` if by these settings a captured landmark would be another."""
        if (config.names, config.positions) == (self.config.names, self.config.positions):
            return
        places = dict(zip(config.names, np.reshape(config.positions, (-1, 3))))
        for each in self.landmarks:
            if each.name not in places or not np.array_equal(places[each.name], each.model):
                raise InputError(f'landmark "{each.name}" is captured; clear before renaming, '
                                 'moving or dropping it')

    def configure(self, config: LandmarksConfig) -> None:
        """Name landmarks and judge rest by these settings; what has been touched stays."""
        self.config = self.tip.config = config

    @property
    def to_come(self) -> list[str]:
        """Names of the landmarks not captured yet."""
        captured = {each.name for each in self.landmarks}
        return [name for name in self.config.names if name not in captured]

    @property
    def pairs(self) -> tuple[Array, Array] | None:
        """Model and tracker positions, (k, 3) each, m; None while there are fewer than three."""
        return None if len(self.landmarks) < 3 else self._pairs()

    def _pairs(self) -> tuple[Array, Array]:
        return (np.array([landmark.model for landmark in self.landmarks]),
                np.array([landmark.tracker for landmark in self.landmarks]))

    def capture(self, now: float | None) -> tuple[Answer, StationaryTip | None]:
        """Take the resting tip as the next landmark, or say why not; return the rest it took."""
        if not self.config.names:
            return Answer(False, 'no landmarks are named; set landmarks.names and '
                          'landmarks.positions'), None
        if not self.to_come:
            return Answer(False, 'all landmarks are captured; register, or clear '
                          'to begin anew'), None
        name = self.to_come[0]
        try:
            rest = self.tip.rest(now)
        except InputError as refusal:
            return Answer(False, f'landmark "{name}" not captured: {refusal.message}'), None
        for other in self.landmarks:
            if np.linalg.norm(rest.position - other.tracker) <= self.config.radius:
                return Answer(
                    False, f'the tip is still at landmark "{other.name}"; touch "{name}"'), None
        row = 3 * self.config.names.index(name)
        model = np.array(self.config.positions[row:row + 3])
        self.landmarks.append(
            CapturedLandmark(name, model, rest.position, rest.spread_rms, rest.stamp))
        todo = f'next is "{self.to_come[0]}"' if self.to_come else 'that was the last one'
        doubt = disagreement([each.name for each in self.landmarks], *self._pairs())
        return Answer(True, '; '.join(filter(None, (
            f'landmark "{name}" captured from {rest.samples} samples, spread '
            f'{1e3 * rest.spread_rms:.2f} mm RMS', doubt, todo)))), rest

    def verify(self, rest: StationaryTip, field: Field, T_bone_tracker: Array, limit: float) -> Answer:
        """Measure how far ``rest`` is from the registered surface against ``limit``, m."""
        distance = distance_to(field, T_bone_tracker, rest.position)
        now = verified(rest, distance, self.verifications)
        words = sentence(now, self.verifications, limit)
        self.verifications.append(now)
        return Answer(max(abs(now.distance_m), now.moved_m or 0.0) <= limit, words)

    def misses(self, T_tracker_bone: Array) -> dict[str, float]:
        """Return how far each landmark was touched from its place on the registered bone, m."""
        return {each.name: float(np.linalg.norm(
            transform(T_tracker_bone, each.model) - each.tracker)) for each in self.landmarks}

    def odd_one(self, T_tracker_bone: Array) -> str:
        """Name the landmark that was touched elsewhere, as the registered bone shows, if any."""
        misses = self.misses(T_tracker_bone)
        name = max(misses, key=misses.__getitem__, default='')
        if not name or misses[name] <= FAR:
            return ''
        return (f'landmark "{name}" was touched {1e3 * misses[name]:.0f} mm from its place: '
                'was it another one?')
