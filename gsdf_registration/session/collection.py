# SPDX-License-Identifier: Apache-2.0
"""
Collected points: which samples are accepted, to which stroke they belong, how they are stored.

A sample passes two groups of checks and is counted under the first that fails.  The first group
checks the sample itself, whether points are collected or not: finite, in the session frame, later
than the last of its source, not stale, of good quality.  The second group decides whether it joins
the collection: collecting, not a duplicate, not too fast, not full.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import MAX_COORDINATE
from gsdf_registration.common.samples import Points, Position, Rejection, Sample
from gsdf_registration.common.tool_pose import is_valid, tip_positions
from gsdf_registration.session.tip_stream import TipStream

INITIAL_CAPACITY = 1024     # points
NO_TOOL = np.full(7, np.nan)


@dataclass
class Stroke:
    """A stroke: its number, its number of points, and what split it from the one before, if any."""

    number: int
    points: int = 0
    split_by: str = ''      # 'silence', 'jump', 'lift-off', 'landing' or 'touch'


class Collection:
    """
    Points of a session with their strokes, and the count of rejected samples; not thread-safe.

    A stroke contains the points of one source between `start_stroke` and `end_stroke`.  A silence
    longer than ``gate.max_gap``, a jump, or the tip lifting off or landing splits it.

    The arrays returned are read-only views.  Rows once written never change: points are appended,
    and dropping points allocates new arrays.

    Parameters
    ----------
    frame_id : str
        Frame of the points; empty: the frame of the first finite sample.

    """

    def __init__(self, frame_id: str = '') -> None:
        self.collecting = False
        self._next_serial = 0
        self.clear(frame_id)

    def clear(self, frame_id: str = '') -> None:
        """Drop all points, counts and stamps; ``collecting`` stays."""
        self.expect_frame(frame_id)
        self.received = 0
        self.counts = {str(cause): 0 for cause in Rejection}
        self._points = _allocate(INITIAL_CAPACITY)
        self._serials = np.empty(INITIAL_CAPACITY, np.int64)
        self._size = 0
        self._streams: dict[int, TipStream] = {}
        self._strokes: dict[int, Stroke] = {}
        self._next_stroke = 1
        self._recorded_stroke: int | None = None    # `Sample.stroke` of the last sample
        self.last_stroke = 0    # of the last point

    def expect_frame(self, frame_id: str) -> None:
        """Accept points in this frame only; empty: in the frame of the next sample."""
        self.frame_id: str | None = frame_id or None    # None: not known yet

    def __len__(self) -> int:
        """Return the number of points."""
        return self._size

    @property
    def strokes(self) -> int:
        """Number of strokes that contain points."""
        return len(self._strokes)

    def points(self, begin: int = 0) -> Points:
        """Return the points from row ``begin`` on, as read-only views."""
        return Points(*(_read_only(column[begin:self._size]) for column in self._points))

    def serials(self) -> NDArray[np.int64]:
        """Return a number for each point (n,), ascending, which other points' removal keeps."""
        return _read_only(self._serials[:self._size])

    def start_stroke(self) -> None:
        """Start collecting; the next point of each source starts a stroke."""
        self.collecting = True
        for stream in self._streams.values():
            stream.begin_stroke()

    def end_stroke(self) -> None:
        """Stop collecting."""
        self.collecting = False

    def undo(self) -> Stroke | None:
        """Drop the stroke started last and return it; None if there is none."""
        return self.drop_stroke(max(self._strokes, default=0))

    @property
    def stroke_numbers(self) -> list[int]:
        """Numbers of the strokes that contain points, ascending."""
        return sorted(self._strokes)

    def drop_stroke(self, number: int) -> Stroke | None:
        """Drop a stroke and return it; None if there is none. Its points count as rejected."""
        stroke = self._strokes.get(number)
        if stroke is not None:
            self._drop(self._points.strokes[:self._size] == number)
            self.counts[Rejection.UNDONE.value] += stroke.points
        return stroke

    def withdraw(self, source: int, since: float, place: Position, radius: float) -> int:
        """
        Drop the points of a stationary tip, and reject further ones until it has moved away.

        Parameters
        ----------
        source : int
        since : float
            When the tip became stationary, s.
        place : (3,) float
            Where it is stationary, m.
        radius : float
            Points of this source are rejected until one is farther than this from ``place``, m.

        Returns
        -------
        int
            Number of points dropped; they are counted as `Rejection.TOUCHED`.

        """
        mask = ((self._points.sources[:self._size] == source)
                & (self._points.stamps[:self._size] >= since))
        dropped = int(mask.sum())
        if dropped:
            self._drop(mask)
            self.counts[Rejection.TOUCHED.value] += dropped
        self._stream(source).exclude(place, radius)
        return dropped

    def _drop(self, mask: NDArray[np.bool_]) -> None:
        """Remove the rows of ``mask`` (n,), and strokes that are then empty."""
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
        self._store(Points(*(column[keep] for column in self._points)), self._serials[keep])

    def _store(self, points: Points, serials: NDArray[np.int64]) -> None:
        """Store copies of these points (n,), with room for more."""
        room = _allocate(INITIAL_CAPACITY)
        self._points = Points(*(np.concatenate(pair) for pair in zip(points, room)))
        self._serials = np.concatenate([serials, np.empty(INITIAL_CAPACITY, np.int64)])
        self._size = len(serials)

    @property
    def has_tools(self) -> bool:
        """Whether any point was received as the pose of a tool."""
        return not np.isnan(self._points.tools[:self._size, 0]).all()

    def apply_tip(self, tip: Sequence[float]) -> None:
        """Compute the positions of the points again from their tool poses, see `tip_positions`."""
        points = self.points()
        rows = ~np.isnan(points.tools[:, 0])
        positions = points.positions.copy()
        positions[rows] = tip_positions(points.tools[rows], tip)
        self._store(points._replace(positions=positions), self.serials())
        for stream in self._streams.values():
            stream.forget_places()

    def add(self, sample: Sample, source: int, config: Config) -> Rejection | None:
        """
        Add a sample, or return why it is rejected; takes some microseconds.

        The first sample of a source decides whether its stamps use the local clock: if they are
        within ``gate.max_age`` of the arrival.  Only then can a later sample be stale; a recording
        that is played back has a clock of its own and is never too old, however slow the playback.

        Parameters
        ----------
        sample : Sample
        source : int
            Number of its topic; stamps, speed, duplicates and strokes are checked per source.
        config : Config

        Returns
        -------
        Rejection or None
            None if the point was added.

        """
        self.received += 1
        if self.collecting:
            self._follow_recorded_strokes(sample.stroke)
        stream = self._stream(source)
        cause = (self._check_values(sample)
                 or stream.check_sample(sample, config.gate)
                 or (None if self.collecting else Rejection.NOT_COLLECTING)
                 or stream.check_path(sample.stamp, sample.position, config.gate)
                 or (Rejection.FULL if self._size >= config.collect.max_points else None))
        if cause is not None:
            self.counts[cause.value] += 1
            return cause
        stream.accept(sample.stamp, sample.position, config.gate)
        self._append(stream, source, sample)
        return None

    def _follow_recorded_strokes(self, number: int) -> None:
        """Start a stroke if the stroke number of a recording changes."""
        if self._recorded_stroke not in (None, number):
            self.start_stroke()
        self._recorded_stroke = number

    def _stream(self, source: int) -> TipStream:
        stream = self._streams.get(source)
        if stream is None:
            stream = self._streams[source] = TipStream()
        return stream

    def _check_values(self, sample: Sample) -> Rejection | None:
        x, y, z = sample.position
        if not (abs(x) < MAX_COORDINATE and abs(y) < MAX_COORDINATE and abs(z) < MAX_COORDINATE
                and math.isfinite(sample.stamp)):
            return Rejection.NOT_FINITE
        if sample.tool is not None and not is_valid(sample.tool):
            return Rejection.BAD_QUATERNION
        if self.frame_id is None:
            self.frame_id = sample.frame_id
        return Rejection.WRONG_FRAME if sample.frame_id != self.frame_id else None

    def _append(self, stream: TipStream, source: int, sample: Sample) -> None:
        if stream.stroke is None:
            stream.stroke = self._next_stroke
            self._strokes[stream.stroke] = Stroke(stream.stroke, 0, stream.split_by)
            self._next_stroke += 1
        row = self._size
        if row == len(self._serials):
            self._points = Points(*(
                np.concatenate([column, np.empty_like(column)]) for column in self._points))
            self._serials = np.concatenate([self._serials, np.empty_like(self._serials)])
        self._points.positions[row] = sample.position
        self._points.stamps[row] = sample.stamp
        self._points.strokes[row] = self.last_stroke = stream.stroke
        self._points.sources[row] = source
        self._points.tools[row] = NO_TOOL if sample.tool is None else sample.tool
        self._serials[row] = self._next_serial
        self._next_serial += 1
        self._size = row + 1
        self._strokes[stream.stroke].points += 1

    def restore(self, points: Points, frame_id: str | None, counts: dict[str, int],
                config: Config) -> None:
        """
        Replace the points by the ones of a saved session.

        Raises
        ------
        InputError
            If they are too many, or not in the frame of the settings; nothing is changed then.

        """
        if len(points.stamps) > config.collect.max_points:
            raise InputError(f'{len(points.stamps)} points are more than collect.max_points allows '
                             f'({config.collect.max_points})')
        expected = config.points_frame
        if expected and frame_id not in (None, expected):
            raise InputError(f'the points are in frame "{frame_id}", but probe.frame_id is '
                             f'"{expected}"')
        self.clear(expected if frame_id is None else frame_id)
        size = len(points.stamps)
        self._store(points, self._next_serial + np.arange(size))
        self._next_serial += size
        numbers, sizes = np.unique(points.strokes, return_counts=True)
        self._strokes = {number: Stroke(number, size)
                         for number, size in zip(numbers.tolist(), sizes.tolist())}
        self._next_stroke = max(self._strokes, default=0) + 1
        self.counts.update(counts)
        self.received = self._size + sum(self.counts.values())


def _allocate(count: int) -> Points:
    return Points(np.empty((count, 3)), np.empty(count), np.empty(count, np.int32),
                  np.empty(count, np.int32), np.empty((count, 7)))


def _read_only(column: NDArray) -> NDArray:
    view = column.view()
    view.flags.writeable = False
    return view
