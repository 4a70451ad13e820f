# SPDX-License-Identifier: Apache-2.0
"""
What one source delivers, sample by sample: is it believed, and does a new stroke begin with it.

A hand moves some six times as fast through the air as over a bone, be it a slow or a quick one.  So
a stroke ends where the tip becomes ``gate.lift_ratio`` times as fast as it was over the last
seconds, and another begins where it is well below that again: what was recorded in the air is in a
stroke of its own.
"""

from __future__ import annotations

import math
from collections import deque

from gsdf_registration.common.config import GateConfig
from gsdf_registration.common.samples import AGREEING, Position, Rejection

# s, over which speed is judged at least: at 1 kHz the noise of two readings alone makes a fast tip
SHORTEST = 0.01
# s, over which the speed of the hand is taken: it outlasts a jerk, and the tracker's noise is small
LIFT_WINDOW = 0.15
LANDED = 0.7        # of the speed of lifting off: a tip in the air is down again when it is slower
# m/s, of a hand on a bone: until it is known; at least, or a tip that rested lifts when it goes on
USUAL, SLOWEST = 0.03, 0.012
# s, over which the speed of a hand is learnt: some strokes; longer in the air, which is not a bone
MEMORY, AIR_MEMORY = 8.0, 32.0


class TipStream:
    """What must be remembered of one source; positions (3,), m, stamps on its own clock, s."""

    __slots__ = ('_on_our_clock', '_pace', '_rest', '_rest_radius', '_stamp', '_trail', '_turning',
                 '_wild', '_wild_count', '_wild_stamp', 'kept', 'lifted', 'seen', 'seen_stamp',
                 'split_by', 'stroke')

    def __init__(self) -> None:
        self.stroke: int | None = None              # None: the next point starts one
        self.split_by = ''                          # what it starts after; empty: a call
        self.kept: Position | None = None           # the last point kept
        self.seen: Position | None = None           # the last point believed: kept or a duplicate
        self.seen_stamp = -math.inf
        self.lifted = False                         # whether the tip is in the air
        self._stamp = -math.inf                     # of the last sound sample, kept or not
        self._on_our_clock: bool | None = None      # None: not known yet
        self._wild: Position | None = None          # the last point refused as too fast ...
        self._wild_stamp = -math.inf
        self._wild_count = 0                        # ... and how many in a row agree with it
        # kept points back to LIFT_WINDOW ago, and how many in a row say that it lifted or landed
        self._trail: deque[tuple[float, Position]] = deque()
        self._turning = 0
        self._pace = USUAL                          # m/s, geometric mean
        self._rest: Position | None = None          # where it rests for a landmark or verification
        self._rest_radius = 0.0

    def begin_stroke(self, split_by: str = '') -> None:
        """Start a stroke with the next point kept, because of a call or what splits them."""
        if self.stroke is not None or not split_by:
            self.split_by = split_by
        self.stroke = None

    def rest(self, place: Position, radius: float) -> None:
        """Hold back what comes until the tip has left ``place`` by more than ``radius``."""
        self._rest, self._rest_radius = place, radius

    def fault_of_sample(self, stamp: float, arrival: float | None, quality: float | None,
                        gate: GateConfig) -> Rejection | None:
        """Judge a sample by itself."""
        if stamp <= self._stamp:
            return Rejection.NOT_MONOTONIC
        if arrival is not None:
            if self._on_our_clock is None:
                self._on_our_clock = abs(arrival - stamp) <= gate.max_age
            if self._on_our_clock and arrival - stamp > gate.max_age:
                return Rejection.STALE
        if quality is not None and 0.0 < gate.quality < quality:
            return Rejection.POOR_QUALITY
        if stamp - self._stamp > gate.max_gap:
            self._leave('silence')
        self._stamp = stamp
        return None

    def fault_in_stream(self, stamp: float, point: Position, gate: GateConfig) -> Rejection | None:
        """Judge whether a sound sample goes on from those before it."""
        if self._rest is not None:
            if math.dist(point, self._rest) <= self._rest_radius:
                return Rejection.TOUCHED
            self._rest = None
            self._leave('touch')
        if self.kept is not None and math.dist(point, self.kept) <= gate.min_distance:
            self.seen, self.seen_stamp, self._wild_count = point, stamp, 0
            return Rejection.DUPLICATE
        if self.seen is not None and _too_fast(self.seen, self.seen_stamp, point, stamp, gate):
            # One wild point must not lock out all good ones after it, nor a lost track what follows
            # it: a silence, or a few points that agree, and the tip is where they say.
            lost = stamp - self.seen_stamp > gate.max_gap
            if not lost and not self._agrees(stamp, point, gate):
                return Rejection.TOO_FAST
            self._leave('jump')
        return None

    def keep(self, stamp: float, point: Position, gate: GateConfig) -> None:
        """Take note of a point that is kept; `stroke` is then None if a new one begins with it."""
        self.kept = self.seen = point
        self.seen_stamp = stamp
        self._wild_count = 0
        if self.stroke is None:
            self._trail.clear()
            self.lifted = False
        trail = self._trail
        trail.append((stamp, point))
        while len(trail) > 1 and trail[1][0] <= stamp - LIFT_WINDOW:
            trail.popleft()
        if gate.lift_ratio > 0.0:
            self._watch_for_lifting(stamp, point, gate.lift_ratio)

    def _watch_for_lifting(self, stamp: float, point: Position, ratio: float) -> None:
        """Split the stroke where the tip becomes much faster than this hand is, or slow again."""
        first, where = self._trail[0]
        if stamp - first < 0.5 * LIFT_WINDOW:
            return
        speed = math.dist(point, where) / (stamp - first)
        fast = speed > ratio * self._pace * (LANDED if self.lifted else 1.0)
        share = (stamp - self._trail[-2][0]) / (AIR_MEMORY if self.lifted else MEMORY)
        self._pace *= (max(speed, SLOWEST) / self._pace) ** share
        self._turning = self._turning + 1 if fast != self.lifted else 0
        if self._turning >= AGREEING:
            self.begin_stroke('lift-off' if fast else 'landing')
            self.lifted, self._turning = fast, 0

    def _leave(self, split_by: str) -> None:
        """Start a stroke elsewhere, or after a while."""
        self.begin_stroke(split_by)
        self._turning = 0

    def _agrees(self, stamp: float, point: Position, gate: GateConfig) -> bool:
        """Tell whether this too fast point and the ones just before it make one plausible path."""
        alone = self._wild_count == 0 or self._wild is None or _too_fast(
            self._wild, self._wild_stamp, point, stamp, gate)
        self._wild_count = 1 if alone else self._wild_count + 1
        self._wild, self._wild_stamp = point, stamp
        return self._wild_count >= AGREEING


def _too_fast(a: Position, stamp_a: float, b: Position, stamp_b: float, gate: GateConfig) -> bool:
    return math.dist(a, b) > gate.max_speed * max(stamp_b - stamp_a, SHORTEST)
