# SPDX-License-Identifier: Apache-2.0
"""
Transforms each sample into the session frame at its own stamp.

A sample waits until the poses of the reference array and the frames of /tf before and after it are
known. Samples of one topic keep their order; topics do not delay one another.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field

from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.samples import Rejection, Sample, SampleSink
from gsdf_registration.common.tool_pose import moved
from gsdf_registration.tracking.clock import ClockMonitor
from gsdf_registration.tracking.frame_resolver import FrameResolver
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.pose_buffer import LookupStatus

MAX_WAITING = 2000      # samples of a topic; bounds the memory whatever the stamps are


@dataclass
class _Source:
    """State of one topic."""

    waiting: deque[Sample] = field(default_factory=deque)
    stamp: float = math.nan     # of the last sample
    pose: float = math.nan      # stamp of the last array pose that arrived after it
    offset: float = 0.0         # s between stamps of samples and poses that arrive together
    problem: str = ''
    used: bool = False          # whether any sample was passed on


class PointTransformer:
    """
    Passes samples in the session frame to a session; not thread-safe.

    It uses the settings of the sink.

    Parameters
    ----------
    sink : SampleSink
    frames : Frames or None
        None if /tf is not available.

    """

    def __init__(self, sink: SampleSink, frames: Frames | None) -> None:
        self.last_rejection = -math.inf     # when a sample was last rejected here, s, monotonic
        self._sink = sink
        self._resolver = FrameResolver(frames)
        self._clocks: ClockMonitor[Sample] = ClockMonitor()
        self._sources: dict[str, _Source] = {}

    def set_frames(self, frames: Frames | None) -> None:
        """Use another tree of frames from now on."""
        self._resolver.frames = frames

    def clear(self) -> None:
        """Drop waiting samples; the next sample of each topic is its first."""
        self._clocks = ClockMonitor()
        self._drop_waiting()

    def reset(self) -> None:
        """Drop all samples and poses of the array, as a new one; the frames of /tf stay."""
        self._clocks = ClockMonitor()
        self._sources = {}
        self._resolver = FrameResolver(self._resolver.frames)

    def add_point(self, sample: Sample) -> None:
        """Add a sample."""
        if not math.isfinite(sample.stamp):
            self._reject(sample, Rejection.NOT_FINITE)
            return
        went_back, accepted, outliers = self._clocks.add(sample.topic, sample.stamp, sample,
                                                         sample.arrival)
        for outlier in outliers:
            self._reject(outlier, Rejection.NOT_MONOTONIC)
        if went_back:
            self._restart(accepted[0].stamp,
                          f'the stamps of {sample.topic} went back by {went_back:.1f} s')
        for each in accepted:
            if not self._sink.take(each):
                self._transform_or_wait(each)

    def add_pose(self, stamp: float, T: Array, frame_id: str) -> None:
        """Add the pose ``T`` (4, 4), m, of the reference array in ``frame_id``."""
        self._resolver.add_pose(stamp, T, frame_id, self._sink.config)
        self._sink.add_reference_pose(stamp, T)
        for source in self._sources.values():
            source.pose = stamp
        self.process()

    def add_transform(self, parent: str, child: str, stamp: float, T: Array, fixed: bool) -> None:
        """Add ``T_parent_child`` (4, 4), m; ``fixed``: for all times."""
        if self._resolver.frames is not None:
            self._resolver.frames.add(parent, child, stamp, T, fixed)
            self.process()

    def process(self, now: float | None = None) -> None:
        """
        Transform waiting samples whose poses are known; reject those that waited too long.

        ``now``, s, local clock: all input received before this time has been added.
        """
        for source in self._sources.values():
            if source.waiting:
                waiting, source.waiting = source.waiting, deque()
                source.waiting.extend(sample for sample in waiting
                                      if not self._transform(source, sample))
                self._reject_overdue(source, now)

    def finish(self) -> None:
        """Reject all samples that still wait, at the end of the input."""
        for sample in self._clocks.flush():
            self._reject(sample, Rejection.NOT_MONOTONIC)
        for source in self._sources.values():
            problem = source.problem
            while source.waiting:
                self._reject_untransformed(source, source.waiting.popleft())
            if source.used and not self._resolver.pose_rejected:
                source.problem = problem        # the last samples wait for a pose after the end

    def local_clock_went_back(self, before: float, now: float) -> None:
        """Restart the session unless the stamps of the samples have gone back already."""
        if self._clocks.local_clock_went_back(before):
            self._restart(now, f'the clock went back by {before - now:.1f} s')

    def local_clock_replaced(self, now: float, reason: str) -> None:
        """Restart the session: stamps of the new clock cannot be compared with earlier ones."""
        self._clocks = ClockMonitor()
        self._restart(now, reason)

    @property
    def problem(self) -> str:
        """Why samples are rejected, one sentence for each cause; empty if none is."""
        problems = [source.problem for source in self._sources.values()] + self._clocks.problems
        return '; '.join(dict.fromkeys(sentence for sentence in problems if sentence))

    def _restart(self, stamp: float, reason: str) -> None:
        self._drop_waiting()
        self._resolver.rewind(stamp)
        self._sink.restart(reason)

    def _drop_waiting(self) -> None:
        for source in self._sources.values():
            source.waiting.clear()

    def _transform_or_wait(self, sample: Sample) -> None:
        source = self._sources.setdefault(sample.topic, _Source())
        self._compare_clocks(source, sample.stamp)
        if not self._transform(source, sample):
            source.waiting.append(sample)
        self._reject_overdue(source, None)

    def _compare_clocks(self, source: _Source, stamp: float) -> None:
        """Measure the offset between the clocks of samples and array poses."""
        before, source.stamp = source.stamp, stamp
        if not math.isnan(before - source.pose):
            # with one clock, a pose that arrives between two samples is stamped between or near
            offset = min(source.pose - before, source.pose - stamp, key=abs)
            between = before <= source.pose <= stamp
            source.offset = 0.0 if between or abs(offset) <= self._max_age else offset
            source.pose = math.nan

    def _transform(self, source: _Source, sample: Sample) -> bool:
        """Pass a sample on or reject it; return False if it must wait."""
        config = self._sink.config
        T = self._resolver.motion(sample.frame_id, sample.stamp, config)
        if T is LookupStatus.NOT_YET:
            return False
        if T is LookupStatus.NEVER:
            self._reject_untransformed(source, sample)
            return True
        if T is not None:
            x, y, z = transform(T, sample.position).tolist()
            tool = None if sample.tool is None else moved(T, sample.tool)
            sample = sample._replace(position=(x, y, z), frame_id=config.points_frame, tool=tool)
        source.problem, source.used = '', True
        self._sink.add(sample)
        return True

    @property
    def _max_age(self) -> float:
        return self._sink.config.gate.max_age

    def _reject_overdue(self, source: _Source, now: float | None) -> None:
        waiting = source.waiting
        while waiting:
            first = waiting[0]
            if first.arrival is None:       # measure the wait by the clock of the samples
                waited = source.stamp - first.stamp
            else:
                waited = 0.0 if now is None else now - first.arrival
            if waited <= self._max_age and len(waiting) <= MAX_WAITING:
                return
            self._reject_untransformed(source, waiting.popleft())

    def _reject_untransformed(self, source: _Source, sample: Sample) -> None:
        """Reject a sample that cannot be transformed, and record why."""
        cause, source.problem = self._resolver.failure_reason(
            sample.frame_id, sample.topic, source.offset, self._sink.config)
        self._reject(sample, cause)

    def _reject(self, sample: Sample, cause: Rejection) -> None:
        self.last_rejection = time.monotonic()
        self._sink.reject(sample, cause)
