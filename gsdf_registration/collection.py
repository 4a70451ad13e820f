# SPDX-License-Identifier: Apache-2.0
"""
The points a probe delivers: which are believed, how they are held, to which stroke they belong.

A point passes two rows of gates, and is counted under the first that stops it.  The first row looks
at the sample alone and is judged whether we collect or not: finite, in the frame of the session,
later than the last of its source, fresh, of good quality.  The second asks whether it may join the
collection: are we collecting, is it new, could the tip have got there, is there room.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from gsdf_registration.config import GateConfig
from gsdf_registration.result import InputError
from gsdf_registration.rigid import Array

# m; trackers mark a missing value with a huge number as often as with NaN (NDI: -3.7e28)
FARTHEST = 1e6
# this many too fast points in a row that agree with one another are the tip after all
AGREEING = 3
FIRST_ROOM = 1024   # points


class Rejection(str, Enum):
    """Why a point was not kept."""

    NOT_FINITE = 'not_finite'
    WRONG_FRAME = 'wrong_frame'
    NOT_MONOTONIC = 'not_monotonic'
    STALE = 'stale'
    POOR_QUALITY = 'poor_quality'
    NOT_COLLECTING = 'not_collecting'
    DUPLICATE = 'duplicate'
    TOO_FAST = 'too_fast'
    FULL = 'full'

    def __str__(self) -> str:
        """Return the lower-case word used in JSON, logs and status."""
        return self.value

    @property
    def is_of_sample(self) -> bool:
        """Whether the sample itself is at fault: good for nothing, not even a landmark."""
        return self in _OF_SAMPLE


_OF_SAMPLE = frozenset({Rejection.NOT_FINITE, Rejection.WRONG_FRAME, Rejection.NOT_MONOTONIC,
                        Rejection.STALE, Rejection.POOR_QUALITY})
Position = tuple[float, float, float]


class Points(NamedTuple):
    """Collected points, row by row in the order they came."""

    positions: Array        # (n, 3) m, frame of the session
    stamps: Array           # (n,) s, clock of their source
    strokes: np.ndarray     # (n,) int32, rising; a number may be missing after an undo
    sources: np.ndarray     # (n,) int32


class _Source:
    """What must be remembered of one stream of points."""

    __slots__ = ('kept', 'on_our_clock', 'seen', 'seen_stamp', 'stamp', 'stroke', 'wild',
                 'wild_count', 'wild_stamp')

    def __init__(self) -> None:
        self.stamp = -math.inf                      # of the last sound sample, kept or not
        self.on_our_clock: bool | None = None       # None: not known yet
        self.kept: Position | None = None           # the last point kept
        self.seen: Position | None = None           # the last point believed: kept or a duplicate
        self.seen_stamp = -math.inf
        self.stroke: int | None = None              # None: the next point starts one
        self.wild: Position | None = None           # the last point refused as too fast ...
        self.wild_stamp = -math.inf
        self.wild_count = 0                         # ... and how many in a row agree with it


class Collection:
    """
    Points of a session behind their gates, strokes numbered, refusals counted; not thread-safe.

    A stroke is what one source delivers between `start_stroke` and `end_stroke`; a silence longer
    than ``gate.max_gap`` or a jump splits it.

    Parameters
    ----------
    gate : GateConfig
    max_points : int
        Points held at most; further ones are refused as `Rejection.FULL`, none is forgotten.
    frame_id : str
        Frame the points must be in; empty: that of the first finite one.

    """

    def __init__(self, gate: GateConfig, max_points: int, frame_id: str = '') -> None:
        self.gate = gate
        self.max_points = max_points
        self._wanted_frame = frame_id
        self.clear()

    def clear(self) -> None:
        """Forget all points, counts, stamps and the frame learnt; go on collecting, or not."""
        self.frame_id: str | None = self._wanted_frame or None      # None: not known yet
        self.received = 0
        self.undone = 0
        self.counts = {str(cause): 0 for cause in Rejection}
        self.collecting = getattr(self, 'collecting', False)
        self._points = _room_for(FIRST_ROOM)
        self._size = 0
        self._sources: dict[int, _Source] = {}
        self._strokes: dict[int, int] = {}      # number -> points in it
        self._next_stroke = 0

    def __len__(self) -> int:
        """Return the number of points held."""
        return self._size

    @property
    def strokes(self) -> int:
        """Number of strokes that hold points."""
        return len(self._strokes)

    def arrays(self, begin: int = 0) -> Points:
        """Return a copy of the points held, from row ``begin`` on."""
        return Points(*(column[begin:self._size].copy() for column in self._points))

    def start_stroke(self) -> None:
        """Collect from now on; the next point of each source starts a stroke."""
        self.collecting = True
        for source in self._sources.values():
            source.stroke = None

    def end_stroke(self) -> None:
        """Stop collecting."""
        self.collecting = False

    def undo(self) -> int:
        """Drop the stroke begun last and return its number of points; 0 when there is none."""
        if not self._strokes:
            return 0
        last = max(self._strokes)
        keep = np.flatnonzero(self._points.strokes[:self._size] != last)
        for column in self._points:
            column[:len(keep)] = column[keep]
        self._size = len(keep)
        for source in self._sources.values():
            source.stroke = None if source.stroke == last else source.stroke
        dropped = self._strokes.pop(last)
        self.undone += dropped
        return dropped

    def add(self, stamp: float, position: Sequence[float], frame_id: str, source: int = 0,
            arrival: float | None = None, quality: float | None = None) -> Rejection | None:
        """
        Take in one point, or say why not; some microseconds.

        Parameters
        ----------
        stamp : float
            When it was measured, seconds on the clock of the source.
        position : (3,) float
            Metres in ``frame_id``.
        source : int
            Which stream it belongs to; stamps, speed, duplicates and strokes are judged a stream.
        arrival : float, optional
            When it came in, seconds on our clock.  The first point of a source decides whether its
            stamps are on our clock too: within ``gate.max_age`` of the arrival.  Only then a later
            one can be stale; a recording played back has a clock of its own and is never too old,
            however slowly it is played.
        quality : float, optional
            What the tracker says of its error, metres; NaN: it does not know.

        Returns
        -------
        Rejection or None
            None when the point was kept.

        """
        self.received += 1
        x, y, z = position
        point = (float(x), float(y), float(z))
        stream = self._sources.get(source)
        if stream is None:
            stream = self._sources[source] = _Source()
        cause = (self._fault_of_sample(stream, stamp, point, frame_id, arrival, quality)
                 or self._fault_in_stream(stream, stamp, point))
        if cause is not None:
            self.counts[cause.value] += 1
            return cause
        self._keep(stream, source, stamp, point)
        return None

    def _fault_of_sample(self, stream: _Source, stamp: float, point: Position, frame_id: str,
                         arrival: float | None, quality: float | None) -> Rejection | None:
        x, y, z = point
        if not (abs(x) < FARTHEST and abs(y) < FARTHEST and abs(z) < FARTHEST
                and math.isfinite(stamp)):
            return Rejection.NOT_FINITE
        if self.frame_id is None:
            self.frame_id = frame_id
        if frame_id != self.frame_id:
            return Rejection.WRONG_FRAME
        if stamp <= stream.stamp:
            return Rejection.NOT_MONOTONIC
        if arrival is not None:
            if stream.on_our_clock is None:
                stream.on_our_clock = abs(arrival - stamp) <= self.gate.max_age
            if stream.on_our_clock and arrival - stamp > self.gate.max_age:
                return Rejection.STALE
        if quality is not None and 0.0 < self.gate.quality < quality:
            return Rejection.POOR_QUALITY
        if stamp - stream.stamp > self.gate.max_gap:
            stream.stroke = None
        stream.stamp = stamp
        return None

    def _fault_in_stream(self, stream: _Source, stamp: float, point: Position) -> Rejection | None:
        if not self.collecting:
            return Rejection.NOT_COLLECTING
        if stream.kept is not None and math.dist(point, stream.kept) <= self.gate.min_distance:
            stream.seen, stream.seen_stamp, stream.wild_count = point, stamp, 0
            return Rejection.DUPLICATE
        if stream.seen is not None and self._too_fast(stream.seen, stream.seen_stamp, point, stamp):
            # One wild point must not lock out all good ones after it, nor a lost track what follows
            # it: a silence, or a few points that agree, and the tip is where they say.
            lost = stamp - stream.seen_stamp > self.gate.max_gap
            if not lost and not self._agrees(stream, point, stamp):
                return Rejection.TOO_FAST
            stream.stroke = None
        return Rejection.FULL if self._size >= self.max_points else None

    def _too_fast(self, a: Position, stamp_a: float, b: Position, stamp_b: float) -> bool:
        return math.dist(a, b) > self.gate.max_speed * (stamp_b - stamp_a)

    def _agrees(self, stream: _Source, point: Position, stamp: float) -> bool:
        """Tell whether this too fast point and the ones just before it make one plausible path."""
        alone = stream.wild_count == 0 or stream.wild is None or self._too_fast(
            stream.wild, stream.wild_stamp, point, stamp)
        stream.wild_count = 1 if alone else stream.wild_count + 1
        stream.wild, stream.wild_stamp = point, stamp
        return stream.wild_count >= AGREEING

    def _keep(self, stream: _Source, source: int, stamp: float, point: Position) -> None:
        if stream.stroke is None:
            stream.stroke = self._next_stroke
            self._next_stroke += 1
        row = self._size
        if row == len(self._points.stamps):
            self._points = Points(*(
                np.concatenate([column, np.empty_like(column)]) for column in self._points))
        self._points.positions[row] = point
        self._points.stamps[row] = stamp
        self._points.strokes[row] = stream.stroke
        self._points.sources[row] = source
        self._size = row + 1
        self._strokes[stream.stroke] = self._strokes.get(stream.stroke, 0) + 1
        stream.kept = stream.seen = point
        stream.seen_stamp = stamp
        stream.wild_count = 0

    def want_frame(self, frame_id: str) -> None:
        """Expect points in this frame from now on; empty: in that of the next one."""
        self._wanted_frame = frame_id
        self.frame_id = frame_id or None

    def refill(self, points: Points, frame_id: str | None, counts: dict[str, int]) -> None:
        """
        Hold these points instead, as saved by an earlier session.

        Raises
        ------
        InputError
            When they are too many, or in another frame than wanted; nothing is changed then.

        """
        if len(points.stamps) > self.max_points:
            raise InputError(f'{len(points.stamps)} points are more than collect.max_points allows '
                             f'({self.max_points})')
        if self._wanted_frame and frame_id not in (None, self._wanted_frame):
            raise InputError(f'the points are in frame "{frame_id}", but probe.frame_id is '
                             f'"{self._wanted_frame}"')
        self.clear()
        self.frame_id = self.frame_id if frame_id is None else frame_id
        self._points = Points(*(
            np.concatenate([column, room]) for column, room in zip(points, _room_for(FIRST_ROOM))))
        self._size = len(points.stamps)
        numbers, sizes = np.unique(points.strokes, return_counts=True)
        self._strokes = {int(number): int(size) for number, size in zip(numbers, sizes)}
        self._next_stroke = int(numbers.max()) + 1 if len(numbers) else 0
        self.counts.update(counts)
        self.received = self._size + sum(self.counts.values())


def _room_for(count: int) -> Points:
    return Points(np.empty((count, 3)), np.empty(count), np.empty(count, np.int32),
                  np.empty(count, np.int32))
