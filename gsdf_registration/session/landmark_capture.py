# SPDX-License-Identifier: Apache-2.0
"""
Capture of the landmarks named in the settings, from a stationary tip.

Landmarks give the start pose and are not used in the fit: they are touched where they can be
reached, over soft tissue and some millimetres off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gsdf_registration.common.config import LandmarksConfig
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.tool_pose import TIP_UNKNOWN, ToolPose, tip_position
from gsdf_registration.registration.landmarks import MIN_LANDMARKS, disagreement
from gsdf_registration.session.stationary_tip import StationaryTip, StationaryTipDetector

MISPLACED = 0.015       # m; a landmark touched this far from its place was probably another one


@dataclass(frozen=True)
class Answer:
    """Success or failure, and one sentence."""

    success: bool
    message: str
    # what was measured, for programs: a landmark and its tip, a verification point, or a result
    detail: Any = field(default=None, compare=False)


@dataclass(frozen=True)
class CapturedLandmark:
    """A named model point and the tip position measured on it."""

    name: str
    model: Array        # (3,) m, bone frame
    tracker: Array      # (3,) m, session frame
    spread_m: float     # root mean square of the samples about their mean
    stamp: float        # s
    tool: ToolPose | None = None    # mean pose of the tool, session frame; None: not received
    sigma_m: float = 0.0    # standard deviation per axis; 0: only for an initial guess


def with_tip(captured: Sequence[CapturedLandmark],
             tip: Sequence[float]) -> list[CapturedLandmark]:
    """Return the landmarks with the touched positions for this tip of the tool."""
    return [each if each.tool is None else
            replace(each, tracker=np.array(tip_position(each.tool, tip))) for each in captured]


class LandmarkCapture:
    """The captured landmarks of a session, in order; not thread-safe."""

    def __init__(self) -> None:
        self.captured: list[CapturedLandmark] = []

    def add(self, landmark: CapturedLandmark, config: LandmarksConfig) -> None:
        """
        Add a landmark, or replace the one of the same name.

        They are in the order of ``landmarks.names``, which a replay repeats: while the centre of a
        joint is computed, others may be captured.
        """
        others = [each for each in self.captured if each.name != landmark.name]
        places = {name: place for place, name in enumerate(config.names)}
        self.captured = sorted([*others, landmark],
                               key=lambda each: places.get(each.name, len(places)))

    def apply_sigmas(self, config: LandmarksConfig) -> None:
        """Use the standard deviations of these settings; that of a joint centre was measured."""
        self.captured = [
            each if each.name == config.joint_centre or each.name not in config.names else
            replace(each, sigma_m=config.sigma_of(each.name)) for each in self.captured]

    def apply_tip(self, tip: Sequence[float]) -> None:
        """Compute the touched positions again from the tool poses, see `tip_position`."""
        self.captured = with_tip(self.captured, tip)

    @property
    def has_tools(self) -> bool:
        """Whether any landmark was touched with a tool whose pose was received."""
        return any(each.tool is not None for each in self.captured)

    def check(self, config: LandmarksConfig, before: LandmarksConfig) -> None:
        """Raise `InputError` if these settings change a landmark that is captured."""
        if (config.names, config.positions) == (before.names, before.positions):
            return
        positions = dict(zip(config.names, np.reshape(config.positions, (-1, 3))))
        for each in self.captured:
            if each.name not in positions or not np.array_equal(positions[each.name], each.model):
                raise InputError(f'landmark "{each.name}" is captured; clear before renaming, '
                                 'moving or removing it')

    def remaining(self, config: LandmarksConfig) -> list[str]:
        """Return the names of the landmarks that are not captured yet."""
        captured = {each.name for each in self.captured} | {config.joint_centre}
        return [name for name in config.names if name not in captured]

    @property
    def landmarks(self) -> Landmarks:
        """The captured landmarks."""
        return Landmarks(tuple(each.name for each in self.captured),
                         np.reshape([each.model for each in self.captured], (-1, 3)),
                         np.reshape([each.tracker for each in self.captured], (-1, 3)),
                         np.array([each.sigma_m for each in self.captured], dtype=np.float64))

    @property
    def usable(self) -> Landmarks:
        """Those that say something of the pose: fewer than three must be measurements."""
        found = self.landmarks
        return found if len(found) >= MIN_LANDMARKS else found.measured

    def capture(self, detector: StationaryTipDetector, config: LandmarksConfig,
                now: float | None, tip_missing: bool = False
                ) -> tuple[Answer, StationaryTip | None]:
        """
        Capture the next landmark, or return why not; also return the tip that was used.

        ``tip_missing``: the place of the tip on the tool is not known, so positions follow later.
        """
        if not config.names:
            return Answer(False, 'no landmarks are named; set landmarks.names and '
                          'landmarks.positions'), None
        remaining = self.remaining(config)
        if not remaining:
            return Answer(False, 'all landmarks are captured; register, or clear '
                          'to start again'), None
        name = remaining[0]
        try:
            tip = detector.detect(config, now)
        except InputError as error:
            return Answer(False, f'landmark "{name}" not captured: {error.message}'), None
        for other in self.captured:
            if np.linalg.norm(tip.position - other.tracker) <= config.radius:
                return Answer(
                    False, f'the tip is still at landmark "{other.name}"; touch "{name}"'), None
        row = 3 * config.names.index(name)
        model = np.array(config.positions[row:row + 3])
        self.add(CapturedLandmark(name, model, tip.position, tip.spread_rms, tip.stamp, tip.tool,
                                  config.sigma_of(name)), config)
        following = f'next is "{remaining[1]}"' if len(remaining) > 1 else 'this was the last one'
        captured = self.landmarks
        warning = TIP_UNKNOWN if tip_missing else disagreement(captured.names, captured.model,
                                                               captured.touched)
        return Answer(True, '; '.join(filter(None, (
            f'landmark "{name}" captured from {tip.samples} samples, spread '
            f'{1e3 * tip.spread_rms:.2f} mm RMS', warning, following))), (name, tip)), tip

    def errors(self, T_tracker_bone: Array) -> dict[str, float]:
        """Return the distance of each landmark from its place on the registered bone, m."""
        return {each.name: float(np.linalg.norm(
            transform(T_tracker_bone, each.model) - each.tracker)) for each in self.captured}

    def misplaced(self, T_tracker_bone: Array) -> str:
        """
        Return a sentence on the landmark with the largest error, if that is too large.

        Those with a standard deviation are judged by the registration.
        """
        guesses = {each.name for each in self.captured if not each.sigma_m}     # no measurements
        errors = {name: error for name, error in self.errors(T_tracker_bone).items()
                  if name in guesses}
        name = max(errors, key=errors.__getitem__, default='')
        if not name or errors[name] <= MISPLACED:
            return ''
        return (f'landmark "{name}" was touched {1e3 * errors[name]:.0f} mm from its place: '
                'was another one touched?')
