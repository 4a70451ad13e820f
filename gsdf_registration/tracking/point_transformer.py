# SPDX-License-Identifier: Apache-2.0
"""
What a session is fed: points, each carried into the session's frame at its own stamp.

A point waits until it is known where the reference array and the frames of /tf were before and
after it.  So points keep their order, a source for itself, and none holds up another.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.tracking.clock import ClockWatch
from gsdf_registration.tracking.frame_resolver import FrameResolver
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.pose_buffer import LookupStatus

MOST_WAITING = 2000     # points of a source; bounds the memory whatever the stamps say


class Sink(Protocol):
    """Who is fed."""

    def take(self, sample: Sample) -> None:
        """Take a point in the frame of the session."""

    def refuse(self, sample: Sample, cause: Rejection) -> None:
        """Count a point that cannot be carried there."""

    def start_anew(self, why: str) -> None:
        """Begin a new session: the clock of the points has gone back."""


@dataclass
class _Source:
    """What must be remembered of one stream of points."""

    waiting: deque[Sample] = field(default_factory=deque)
    stamp: float = math.nan     # of the last point
    pose: float = math.nan      # stamp of the last pose of the array that came since
    apart: float = 0.0          # s between the stamps of points and poses that come together
    trouble: str = ''


class PointTransformer:
    """
    Carries points to a session; not thread-safe.

    Parameters
    ----------
    config : Config
    sink : Sink
    frames : Frames or None
        None where /tf is not heard.

    """

    def __init__(self, config: Config, sink: Sink, frames: Frames | None) -> None:
        self._sink = sink
        self._route = FrameResolver(config, frames)
        self._watch: ClockWatch[Sample] = ClockWatch()
        self._sources: dict[str, _Source] = {}

    def configure(self, config: Config, frames: Frames | None) -> None:
        """Work by these settings from now on, and with these frames."""
        self._route.config, self._route.frames = config, frames

    def forget(self) -> None:
        """Take whatever comes next as the first of its source: all has been cleared."""
        self._watch = ClockWatch()
        for source in self._sources.values():
            source.waiting.clear()

    def point(self, sample: Sample) -> None:
        """Take in a point."""
        if not math.isfinite(sample.stamp):
            self._sink.refuse(sample, Rejection.NOT_FINITE)
            return
        back, going_on, strays = self._watch.take(sample.source, sample.stamp, sample,
                                                  sample.arrival)
        for stray in strays:
            self._sink.refuse(stray, Rejection.NOT_MONOTONIC)
        if back:
            self._start_anew(going_on[0].stamp,
                             f'the stamps of {sample.source} went back by {back:.1f} s')
        for one in going_on:
            self._carry_or_wait(one)

    def pose(self, stamp: float, T: Array, frame_id: str) -> None:
        """Take in the pose ``T`` (4, 4), m, of the reference array in ``frame_id``."""
        self._route.pose(stamp, T, frame_id)
        for source in self._sources.values():
            source.pose = stamp
        self.serve()

    def transform(self, parent: str, child: str, stamp: float, T: Array, fixed: bool) -> None:
        """Take in ``T_parent_child`` (4, 4), m; ``fixed``: for all times."""
        if self._route.frames is not None:
            self._route.frames.add(parent, child, stamp, T, fixed)
            self.serve()

    def serve(self, now: float | None = None) -> None:
        """
        Carry on the points whose time has come, and refuse those that waited for too long.

        All that came in until ``now``, s on our clock, has been fed.
        """
        for source in self._sources.values():
            if source.waiting:
                waited, source.waiting = source.waiting, deque()
                source.waiting.extend(sample for sample in waited
                                      if not self._carry(source, sample))
                self._refuse_overdue(source, now)

    def end(self) -> None:
        """Decide on all that still wait: nothing more will come."""
        for sample in self._watch.end():
            self._sink.refuse(sample, Rejection.NOT_MONOTONIC)
        for source in self._sources.values():
            while source.waiting:
                self._refuse(source, source.waiting.popleft())

    def our_clock_went_back(self, before: float, now: float) -> None:
        """Begin a new session unless the points have shown already that the time went back."""
        if self._watch.our_clock_went_back(before):
            self._start_anew(now, f'the clock went back by {before - now:.1f} s')

    @property
    def trouble(self) -> str:
        """Why points have been refused of late, a sentence for each cause; else empty."""
        told = [source.trouble for source in self._sources.values()] + self._watch.trouble
        return '; '.join(dict.fromkeys(sentence for sentence in told if sentence))

    def _start_anew(self, stamp: float, why: str) -> None:
        for source in self._sources.values():
            source.waiting.clear()
        self._route.rewind(stamp)
        self._sink.start_anew(why)

    def _carry_or_wait(self, sample: Sample) -> None:
        source = self._sources.setdefault(sample.source, _Source())
        before, source.stamp = source.stamp, sample.stamp
        if not math.isnan(before - source.pose):
            # of one clock a pose that came between two points is between them, or near to one
            apart = min(source.pose - before, source.pose - sample.stamp, key=abs)
            between = before <= source.pose <= sample.stamp
            source.apart = 0.0 if between or abs(apart) <= self._max_age else apart
            source.pose = math.nan
        if not self._carry(source, sample):
            source.waiting.append(sample)
        self._refuse_overdue(source, None)

    def _carry(self, source: _Source, sample: Sample) -> bool:
        """Hand a point on or refuse it; return False if it must wait."""
        T = self._route.motion(sample.frame_id, sample.stamp)
        if T is LookupStatus.NOT_YET:
            return False
        if T is LookupStatus.NEVER:
            self._refuse(source, sample)
            return True
        if T is not None:
            sample = sample._replace(position=transform(T, sample.position).tolist(),
                                     frame_id=self._route.config.points_frame)
        source.trouble = ''
        self._sink.take(sample)
        return True

    @property
    def _max_age(self) -> float:
        return self._route.config.gate.max_age

    def _refuse_overdue(self, source: _Source, now: float | None) -> None:
        waiting = source.waiting
        while waiting:
            first = waiting[0]
            if first.arrival is None:       # then the clock of the points must tell
                waited = source.stamp - first.stamp
            else:
                waited = 0.0 if now is None else now - first.arrival
            if waited <= self._max_age and len(waiting) <= MOST_WAITING:
                return
            self._refuse(source, waiting.popleft())

    def _refuse(self, source: _Source, sample: Sample) -> None:
        """Count a point that cannot be carried, and say why."""
        cause, source.trouble = self._route.failure_reason(sample.frame_id, sample.source, source.apart)
        self._sink.refuse(sample, cause)
