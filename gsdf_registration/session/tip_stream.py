# SPDX-License-Identifier: Apache-2.0
"""
Checks of the samples of one source, and the points where its strokes begin.

A hand moves the tip about six times as fast through the air as over a bone, whether it is a slow
hand or a fast one.  A stroke therefore ends where the tip becomes ``gate.lift_ratio`` times as fast
as it was over the last seconds, and another begins where it is well below that speed again.  Points
measured in the air are then in strokes of their own.
"""

from __future__ import annotations

import math
from collections import deque

from gsdf_registration.common.config import GateConfig
from gsdf_registration.common.samples import AGREEING, Position, Rejection, Sample

# s, minimum time between two points for their speed: at 1 kHz the noise alone looks fast
MIN_INTERVAL = 0.01
# s over which the speed of the tip is measured: longer than a jerk, and averages tracker noise
SPEED_WINDOW = 0.15
LANDING_RATIO = 0.7     # of the lift-off speed: a tip in the air has landed when it is slower
# m/s, speed of a hand on a bone: initial value; minimum, or a stationary tip lifts as it moves on
INITIAL_SPEED, MIN_SPEED = 0.03, 0.012
# s, time constants of the usual speed on the bone: some strokes; longer while the tip is in the air
TIME_CONSTANT, AIR_TIME_CONSTANT = 8.0, 32.0


class TipStream:
    """State of one source; positions (3,), m, stamps on its own clock, s."""

    __slots__ = ('_excluded', '_excluded_radius', '_has_local_clock', '_last', '_outlier',
                 '_outlier_count', '_outlier_stamp', '_plausible', '_plausible_stamp', '_stamp',
                 '_trail', '_turning', '_usual_speed', 'lifted', 'split_by', 'stroke')

    def __init__(self) -> None:
        self.stroke: int | None = None              # None: the next point starts one
        self.split_by = ''                          # why it starts; empty: by a call
        self.lifted = False                         # whether the tip is in the air
        self._last: Position | None = None          # the last accepted point
        self._plausible: Position | None = None     # the last point that was not too fast
        self._plausible_stamp = -math.inf
        self._stamp = -math.inf                     # of the last valid sample, accepted or not
        self._has_local_clock: bool | None = None   # None: not known yet
        self._outlier: Position | None = None       # the last point rejected as too fast ...
        self._outlier_stamp = -math.inf
        self._outlier_count = 0                     # ... and how many in a row agree with it
        # accepted points of the last SPEED_WINDOW, and how many in a row lifted off or landed
        self._trail: deque[tuple[float, Position]] = deque()
        self._turning = 0
        self._usual_speed = INITIAL_SPEED           # m/s, geometric mean
        self._excluded: Position | None = None      # a landmark or verification point
        self._excluded_radius = 0.0

    def begin_stroke(self, split_by: str = '') -> None:
        """Start a stroke with the next accepted point; ``split_by``: the reason, if no call."""
        if self.stroke is not None or not split_by:
            self.split_by = split_by
        self.stroke = None

    def exclude(self, place: Position, radius: float) -> None:
        """Reject points until one is farther than ``radius`` from ``place``."""
        self._excluded, self._excluded_radius = place, radius

    def forget_places(self) -> None:
        """Forget where the tip was, because its place on the tool changes; the stroke goes on."""
        self._last = self._plausible = self._outlier = self._excluded = None
        self._outlier_count = self._turning = 0
        self._trail.clear()

    def check_sample(self, sample: Sample, gate: GateConfig) -> Rejection | None:
        """Check stamp, age and quality of a sample."""
        stamp, arrival, quality = sample.stamp, sample.arrival, sample.quality
        if stamp <= self._stamp:
            return Rejection.NOT_MONOTONIC
        if arrival is not None:
            if self._has_local_clock is None:
                self._has_local_clock = abs(arrival - stamp) <= gate.max_age
            if self._has_local_clock and arrival - stamp > gate.max_age:
                return Rejection.STALE
        if quality is not None and 0.0 < gate.quality < quality:
            return Rejection.POOR_QUALITY
        if stamp - self._stamp > gate.max_gap:
            self._split('silence')
        self._stamp = stamp
        return None

    def check_path(self, stamp: float, point: Position, gate: GateConfig) -> Rejection | None:
        """Check whether a valid sample continues the path of the tip."""
        if self._excluded is not None:
            if math.dist(point, self._excluded) <= self._excluded_radius:
                return Rejection.TOUCHED
            self._excluded = None
            self._split('touch')
        if self._last is not None and math.dist(point, self._last) <= gate.min_distance:
            self._plausible, self._plausible_stamp, self._outlier_count = point, stamp, 0
            return Rejection.DUPLICATE
        if self._plausible is not None and _too_fast(self._plausible, self._plausible_stamp, point,
                                                     stamp, gate):
            # An outlier must not cause the rejection of all good points after it, nor a lost track
            # the rejection of what follows: after a silence, or when a few points agree, the tip is
            # at the new place.
            lost = stamp - self._plausible_stamp > gate.max_gap
            if not lost and not self._agrees(stamp, point, gate):
                return Rejection.TOO_FAST
            self._split('jump')
        return None

    def accept(self, stamp: float, point: Position, gate: GateConfig) -> None:
        """Record an accepted point; `stroke` is None afterwards if a new one begins with it."""
        self._last = self._plausible = point
        self._plausible_stamp = stamp
        self._outlier_count = 0
        if self.stroke is None:
            self._trail.clear()
            self.lifted = False
        trail = self._trail
        trail.append((stamp, point))
        while len(trail) > 1 and trail[1][0] <= stamp - SPEED_WINDOW:
            trail.popleft()
        if gate.lift_ratio > 0.0:
            self._detect_lifting(stamp, point, gate.lift_ratio)

    def _detect_lifting(self, stamp: float, point: Position, ratio: float) -> None:
        """Split the stroke where the tip becomes much faster than usual, or slow again."""
        first, where = self._trail[0]
        if stamp - first < 0.5 * SPEED_WINDOW:
            return
        speed = math.dist(point, where) / (stamp - first)
        fast = speed > ratio * self._usual_speed * (LANDING_RATIO if self.lifted else 1.0)
        time_constant = AIR_TIME_CONSTANT if self.lifted else TIME_CONSTANT
        exponent = (stamp - self._trail[-2][0]) / time_constant
        self._usual_speed *= (max(speed, MIN_SPEED) / self._usual_speed) ** exponent
        self._turning = self._turning + 1 if fast != self.lifted else 0
        if self._turning >= AGREEING:
            self.begin_stroke('lift-off' if fast else 'landing')
            self.lifted, self._turning = fast, 0

    def _split(self, split_by: str) -> None:
        """Start a stroke at another place or time."""
        self.begin_stroke(split_by)
        self._turning = 0

    def _agrees(self, stamp: float, point: Position, gate: GateConfig) -> bool:
        """Return whether this outlier and the ones just before it make a plausible path."""
        alone = self._outlier_count == 0 or self._outlier is None or _too_fast(
            self._outlier, self._outlier_stamp, point, stamp, gate)
        self._outlier_count = 1 if alone else self._outlier_count + 1
        self._outlier, self._outlier_stamp = point, stamp
        return self._outlier_count >= AGREEING


def _too_fast(a: Position, stamp_a: float, b: Position, stamp_b: float, gate: GateConfig) -> bool:
    return math.dist(a, b) > gate.max_speed * max(stamp_b - stamp_a, MIN_INTERVAL)
