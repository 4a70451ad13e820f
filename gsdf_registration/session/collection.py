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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.config import GateConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import FARTHEST
from gsdf_registration.common.samples import Points, Position, Rejection
from gsdf_registration.session.tip_stream import TipStream

FIRST_ROOM = 1024   # points


@dataclass
class Stroke:
    """A stroke: its number, its points, and what split it from the one before, if no call did."""

    number: int
    points: int = 0
    split_by: str = ''      # 'silence', 'jump', 'lift-off', 'landing' or 'touch'


class Collection:
    """
    Points of a session behind their gates, strokes numbered, refusals counted; not thread-safe.

    A stroke is what one source delivers between `start_stroke` and `end_stroke`; a silence longer
    than ``gate.max_gap``, a jump, or the tip lifting off or landing splits it.

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
        self.collecting = False
        self.wanted_frame = frame_id
        self._next_serial = 0
        self.clear()

    def clear(self) -> None:
        """Forget all points, counts, stamps and the frame learnt; go on collecting, or not."""
        self.frame_id: str | None = self.wanted_frame or None      # None: not known yet
        self.received = 0
        self.undone = 0
        self.counts = {str(cause): 0 for cause in Rejection}
        self._points = _room_for(FIRST_ROOM)
        self._serials = np.empty(FIRST_ROOM, np.int64)
        self._size = 0
        self._streams: dict[int, TipStream] = {}
        self._strokes: dict[int, Stroke] = {}
        self._next_stroke = 1
        self.last_stroke = 0    # of the point kept last

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

    def serials(self) -> NDArray[np.int64]:
        """Return a number for each point held (n,), rising, that stays when others are dropped."""
        return self._serials[:self._size].copy()

    def start_stroke(self) -> None:
        """Collect from now on; the next point of each source starts a stroke."""
        self.collecting = True
        for stream in self._streams.values():
            stream.begin_stroke()

    def end_stroke(self) -> None:
        """Stop collecting."""
        self.collecting = False

    def undo(self) -> Stroke | None:
        """Drop the stroke begun last and return it; None when there is none."""
        if not self._strokes:
            return None
        last = self._strokes[max(self._strokes)]
        self._drop(self._points.strokes[:self._size] == last.number)
        self.undone += last.points
        return last

    def withdraw(self, source: int, since: float, place: Position, radius: float) -> int:
        """
        Drop what ``source`` delivered since it came to rest, and hold back what it still does.

        Parameters
        ----------
        since : float, s, when it came to rest
        place : (3,) m, where it rests; until it has left that by more than ``radius``, m, nothing
            of it is kept

        Returns
        -------
        int
            Points dropped; they are counted as `Rejection.TOUCHED`.

        """
        mask = (self._points.sources[:self._size] == source) & (self._points.stamps[:self._size]
                                                                >= since)
        dropped = int(mask.sum())
        if dropped:
            self._drop(mask)
            self.counts[Rejection.TOUCHED.value] += dropped
        self._stream(source).rest(place, radius)
        return dropped

    def _drop(self, mask: NDArray[np.bool_]) -> None:
        """Forget the rows of ``mask`` (n,), and strokes that then hold none."""
        numbers, sizes = np.unique(self._points.strokes[:self._size][mask], return_counts=True)
        for number, size in zip(numbers.tolist(), sizes.tolist()):
            if size == self._strokes[number].points:
                del self._strokes[number]
            else:
                self._strokes[number].points -= size
        for stream in self._streams.values():
            if stream.stroke not in self._strokes:
                stream.begin_stroke()
        keep = np.flatnonzero(~mask)
        for column in (*self._points, self._serials):
            column[:len(keep)] = column[keep]
        self._size = len(keep)

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
        stream = self._stream(source)
        cause = (self._fault_of_sample(stamp, point, frame_id)
                 or stream.fault_of_sample(stamp, arrival, quality, self.gate)
                 or (None if self.collecting else Rejection.NOT_COLLECTING)
                 or stream.fault_in_stream(stamp, point, self.gate)
                 or (Rejection.FULL if self._size >= self.max_points else None))
        if cause is not None:
            self.counts[cause.value] += 1
            return cause
        stream.keep(stamp, point, self.gate)
        self._keep(stream, source, stamp, point)
        return None

    def _stream(self, source: int) -> TipStream:
        stream = self._streams.get(source)
        if stream is None:
            stream = self._streams[source] = TipStream()
        return stream

    def _fault_of_sample(self, stamp: float, point: Position, frame_id: str) -> Rejection | None:
        x, y, z = point
        if not (abs(x) < FARTHEST and abs(y) < FARTHEST and abs(z) < FARTHEST
                and math.isfinite(stamp)):
            return Rejection.NOT_FINITE
        if self.frame_id is None:
            self.frame_id = frame_id
        return Rejection.WRONG_FRAME if frame_id != self.frame_id else None

    def _keep(self, stream: TipStream, source: int, stamp: float, point: Position) -> None:
        if stream.stroke is None:
            stream.stroke = self._next_stroke
            self._strokes[stream.stroke] = Stroke(stream.stroke, 0, stream.split_by)
            self._next_stroke += 1
        row = self._size
        if row == len(self._serials):
            self._points = Points(*(
                np.concatenate([column, np.empty_like(column)]) for column in self._points))
            self._serials = np.concatenate([self._serials, np.empty_like(self._serials)])
        self._points.positions[row] = point
        self._points.stamps[row] = stamp
        self._points.strokes[row] = self.last_stroke = stream.stroke
        self._points.sources[row] = source
        self._serials[row] = self._next_serial
        self._next_serial += 1
        self._size = row + 1
        self._strokes[stream.stroke].points += 1

    def want_frame(self, frame_id: str) -> None:
        """Expect points in this frame from now on; empty: in that of the next one."""
        self.wanted_frame = frame_id
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
        if self.wanted_frame and frame_id not in (None, self.wanted_frame):
            raise InputError(f'the points are in frame "{frame_id}", but probe.frame_id is '
                             f'"{self.wanted_frame}"')
        self.clear()
        self.frame_id = self.frame_id if frame_id is None else frame_id
        self._points = Points(*(
            np.concatenate([column, room]) for column, room in zip(points, _room_for(FIRST_ROOM))))
        self._size = len(points.stamps)
        self._serials = self._next_serial + np.arange(self._size + FIRST_ROOM)
        self._next_serial += self._size
        numbers, sizes = np.unique(points.strokes, return_counts=True)
        self._strokes = {number: Stroke(number, size)
                         for number, size in zip(numbers.tolist(), sizes.tolist())}
        self._next_stroke = max(self._strokes, default=0) + 1
        self.counts.update(counts)
        self.received = self._size + sum(self.counts.values())


def _room_for(count: int) -> Points:
    return Points(np.empty((count, 3)), np.empty(count), np.empty(count, np.int32),
                  np.empty(count, np.int32))
