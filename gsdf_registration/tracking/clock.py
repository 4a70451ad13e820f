# SPDX-License-Identifier: Apache-2.0
"""
Clocks that leap: a recording that starts again, a simulation that is reset, a probe back in view.

A late packet and a garbled stamp leap too, but alone.  So a leap is believed only when a few stamps
in a row make it and agree with one another; until then they are held, and none of them is lost.
"""

from __future__ import annotations

import math
from typing import Generic, NamedTuple, TypeVar

BACK = 1.0      # s; stamps that go back by less are late, not of a clock that went back
FORWARD = 10.0  # s; stamps that go forward by less need no others to be believed
AGREEING = 3    # stamps in a row that leap and rise again

T = TypeVar('T')


class Taken(NamedTuple, Generic[T]):
    """What is known after a sample has come in."""

    back: float         # how far the clock has gone back, as is evident now, s; else 0
    going_on: list[T]   # the samples to go on with, in the order they came
    strays: list[T]     # those that turn out to have leapt alone


class Stream(Generic[T]):
    """
    The samples of one clock, in the order they come.

    Where it is ``expected`` to go back, because another did, what it still brings of the time
    before is astray.  If it goes on regardless, it is heard again after `BACK` seconds of it.
    """

    def __init__(self) -> None:
        self.expected = False
        self.newest = -math.inf     # s, the highest stamp since the clock last leapt
        self._held: list[T] = []    # they have leapt, perhaps alone
        self._held_stamp = math.nan

    def take(self, stamp: float, sample: T) -> Taken[T]:
        """Take in a sample stamped ``stamp``, s; finite."""
        if self.expected:
            if abs(stamp - self.newest) <= BACK:
                return Taken(0.0, [], [sample])
            self.expected = False
            if stamp < self.newest:
                strays = self._hold(stamp, sample)
                going_on, self._held, self.newest = self._held, [], stamp
                return Taken(0.0, going_on, strays)
        if -BACK <= stamp - self.newest <= FORWARD or self.newest == -math.inf:
            strays, self._held = self._held, []
            self.newest = max(self.newest, stamp)
            return Taken(0.0, [sample], strays)
        strays = self._hold(stamp, sample)
        if len(self._held) < AGREEING:
            return Taken(0.0, [], strays)
        going_on, self._held = self._held, []
        back, self.newest = max(self.newest - stamp, 0.0), stamp
        return Taken(back, going_on, strays)

    def end(self) -> list[T]:
        """Return what is still held; there is nothing more to come."""
        held, self._held = self._held, []
        return held

    def _hold(self, stamp: float, sample: T) -> list[T]:
        """Hold a sample; return those held before that it does not agree with."""
        strays: list[T] = []
        if not 0.0 < stamp - self._held_stamp <= FORWARD:
            strays, self._held = self._held, []
        self._held.append(sample)
        self._held_stamp = stamp
        return strays


class ClockWatch(Generic[T]):
    """The clocks of all sources of points: tells once when they go back together."""

    def __init__(self) -> None:
        self._streams: dict[str, Stream[T]] = {}
        self._since = math.nan      # our clock when a source went back, until ours does

    def take(self, source: str, stamp: float, sample: T, now: float | None) -> Taken[T]:
        """Take in a sample of ``source`` that comes in at ``now`` on our clock, s."""
        stream = self._streams.setdefault(source, Stream())
        taken = stream.take(stamp, sample)
        if taken.back:
            self._expect_all()
            stream.expected = False
            self._since = math.nan if now is None else now
        return taken

    def our_clock_went_back(self, before: float) -> bool:
        """Tell whether our own clock, now less than ``before``, went back before any source did."""
        first = not 0.0 <= before - self._since <= BACK
        self._since = math.nan
        if first:
            self._expect_all()
        return first

    def _expect_all(self) -> None:
        for stream in self._streams.values():
            stream.expected = True

    def end(self) -> list[T]:
        """Return what is still held; there is nothing more to come."""
        return [sample for stream in self._streams.values() for sample in stream.end()]
