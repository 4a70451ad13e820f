# SPDX-License-Identifier: Apache-2.0
"""
Detection of clocks that jump: a looped recording, a reset simulation, a probe back in view.

A delayed packet or a corrupt stamp jumps too, but only once. A jump is therefore accepted only
when a few consecutive stamps make it and agree with one another. Until then these samples are
pending, and none of them is lost. If two programs publish with different clocks, the stamps jump
back and forth; a jump back is therefore accepted only when nothing with the earlier clock has
arrived for a while.
"""

from __future__ import annotations

import math
from typing import Generic, NamedTuple, TypeVar

from gsdf_registration.common.samples import AGREEING

BACK = 1.0      # s; a smaller step back is a late sample, not a clock that went back
FORWARD = 10.0  # s; a smaller step forward needs no confirmation
ALONE = 0.5     # s of stamps that must arrive uninterrupted to confirm a jump back
MIXED = 20      # interruptions in a row by consistent stamps that reveal a second clock
MAX_PENDING = 1000      # samples; bounds the memory whatever the stamps are

T = TypeVar('T')


class StampCheck(NamedTuple, Generic[T]):
    """The outcome of adding a sample."""

    went_back: float    # s by which the clock is now known to have gone back; else 0
    accepted: list[T]   # samples to process, in order of arrival
    outliers: list[T]   # samples whose stamps jumped alone


class StampFilter(Generic[T]):
    """
    Checks the stamps of one source.

    After ``expect_jump`` is set, because another source went back, samples with the earlier clock
    are outliers. If the source keeps that clock, it is accepted again after `BACK` seconds.

    Parameters
    ----------
    strict : bool
        A jump back must be uninterrupted for `ALONE` seconds. Once a second clock is detected, the
        first one is kept.

    """

    def __init__(self, strict: bool = False) -> None:
        self.expect_jump = False
        self.newest = -math.inf     # s, highest stamp since the last accepted jump
        self.offset = 0.0           # s, this clock less a second one on the topic; 0: one clock
        self._strict = strict
        self._pending: list[T] = []     # samples that jumped; not confirmed yet
        self._pending_since = self._pending_stamp = math.nan    # stamps of the first and the last
        self._mixed = 0             # times in a row that the known clock interrupted pending ones
        self._mixed_stamp = math.nan    # stamp of the last interruption

    def add(self, stamp: float, sample: T) -> StampCheck[T]:
        """Check a sample with a finite ``stamp``, s."""
        if self.expect_jump:
            if abs(stamp - self.newest) <= BACK:
                return StampCheck(0.0, [], [sample])
            self.expect_jump = False
            if stamp < self.newest:
                outliers = self._set_pending(stamp, sample)
                accepted, self._pending, self.newest = self._pending, [], stamp
                return StampCheck(0.0, accepted, outliers)
        if -BACK <= stamp - self.newest <= FORWARD or self.newest == -math.inf:
            return self._continue(stamp, sample)
        if self._strict and self.offset and stamp < self.newest:
            self._mixed_stamp = self.newest
            return StampCheck(0.0, [], [*self.flush(), sample])
        outliers = self._set_pending(stamp, sample)
        went_back = max(self.newest - self._pending_since, 0.0)
        if len(self._pending) < AGREEING or (
                self._strict and went_back and stamp - self._pending_since < ALONE
                and len(self._pending) < MAX_PENDING):
            return StampCheck(0.0, [], outliers)
        accepted, self._pending = self._pending, []
        self.newest, self._mixed = stamp, 0
        return StampCheck(went_back, accepted, outliers)

    def flush(self) -> list[T]:
        """Return the pending samples at the end of the input."""
        pending, self._pending = self._pending, []
        return pending

    def _continue(self, stamp: float, sample: T) -> StampCheck[T]:
        """Accept a sample of the known clock; pending samples are outliers then."""
        outliers = self.flush()
        self.newest = max(self.newest, stamp)
        if outliers:
            self._mixed, self._mixed_stamp = self._mixed + 1, stamp
            if self._mixed >= MIXED:
                self.offset = self.newest - self._pending_stamp
        elif stamp - self._mixed_stamp > FORWARD:
            self.offset = 0.0    # the second clock is gone
        return StampCheck(0.0, [sample], outliers)

    def _set_pending(self, stamp: float, sample: T) -> list[T]:
        """Add a pending sample; return earlier pending samples that disagree with it."""
        outliers: list[T] = []
        if not 0.0 < stamp - self._pending_stamp <= FORWARD:
            outliers = self.flush()
        if not 0.0 < stamp - self._pending_stamp <= BACK:
            self._mixed = 0
        if not self._pending:
            self._pending_since = stamp
        self._pending.append(sample)
        self._pending_stamp = stamp
        return outliers


class ClockMonitor(Generic[T]):
    """Checks the stamps of all topics; reports a jump back once if they go back together."""

    def __init__(self) -> None:
        self._filters: dict[str, StampFilter[T]] = {}
        self._since = math.nan      # local time when a topic went back, until the local clock does

    def add(self, topic: str, stamp: float, sample: T, now: float | None) -> StampCheck[T]:
        """Check a sample of ``topic`` that arrives at local time ``now``, s."""
        stamps = self._filters.setdefault(topic, StampFilter(strict=True))
        check = stamps.add(stamp, sample)
        if check.went_back:
            self._expect_jump()
            stamps.expect_jump = False
            self._since = math.nan if now is None else now
        return check

    def local_clock_went_back(self, before: float) -> bool:
        """Return whether the local clock went back from ``before``, s, ahead of every topic."""
        first = not 0.0 <= before - self._since <= BACK
        self._since = math.nan
        if first:
            self._expect_jump()
        return first

    @property
    def problems(self) -> list[str]:
        """One sentence for each topic with two clocks."""
        return [f'the stamps on {topic} come from two clocks, {abs(stamps.offset):.1f} s apart: do '
                'two programs publish there? Points with the second clock are rejected; stop the '
                'first program and clear to use the second'
                for topic, stamps in self._filters.items() if stamps.offset]

    def _expect_jump(self) -> None:
        for stamps in self._filters.values():
            stamps.expect_jump = True

    def flush(self) -> list[T]:
        """Return all pending samples at the end of the input."""
        return [sample for stamps in self._filters.values() for sample in stamps.flush()]
