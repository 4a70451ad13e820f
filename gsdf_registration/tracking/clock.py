# SPDX-License-Identifier: Apache-2.0
"""
Clocks that leap: a recording that starts again, a simulation that is reset, a probe back in view.

A late packet and a garbled stamp leap too, but alone.  So a leap is believed only when a few stamps
in a row make it and agree with one another; until then they are held, and none of them is lost.
Where two programs publish by clocks of their own, stamps leap to and fro; so one that leaps back is
believed only when nothing of the time before has come for a while.
"""

from __future__ import annotations

import math
from typing import Generic, NamedTuple, TypeVar

from gsdf_registration.common.samples import AGREEING

BACK = 1.0      # s; stamps that go back by less are late, not of a clock that went back
FORWARD = 10.0  # s; stamps that go forward by less need no others to be believed
ALONE = 0.5     # s for which stamps must come from back there alone to be believed
MIXED = 20      # stamps that leap one after another and agree are a second clock
MOST_HELD = 1000    # samples held at most, whatever their stamps say

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

    ``wary``: much hangs on it. What goes back must come alone for a while, and once a second clock
    is known to be mixed in, the one heard first is never given up.
    """

    def __init__(self, wary: bool = False) -> None:
        self.expected = False
        self.newest = -math.inf     # s, the highest stamp since the clock last leapt
        self.apart = 0.0            # s from a second clock, mixed in, to this one; 0: there is none
        self._wary = wary
        self._held: list[T] = []    # they have leapt, perhaps alone
        self._held_since = self._held_stamp = math.nan      # stamps of the first and the last
        self._mixed = 0             # times in a row that the clock went on amid held ones ...
        self._mixed_stamp = math.nan    # ... and when it last did

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
            if strays:
                self._mixed, self._mixed_stamp = self._mixed + 1, stamp
                if self._mixed >= MIXED:
                    self.apart = self.newest - self._held_stamp
            elif stamp - self._mixed_stamp > FORWARD:
                self.apart = 0.0    # the other one is gone
            return Taken(0.0, [sample], strays)
        if self._wary and self.apart and stamp < self.newest:
            self._mixed_stamp = self.newest
            return Taken(0.0, [], [*self.end(), sample])
        strays = self._hold(stamp, sample)
        back = max(self.newest - self._held_since, 0.0)
        if len(self._held) < AGREEING or (self._wary and back and stamp - self._held_since < ALONE
                                          and len(self._held) < MOST_HELD):
            return Taken(0.0, [], strays)
        going_on, self._held = self._held, []
        self.newest, self._mixed = stamp, 0
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
        if not 0.0 < stamp - self._held_stamp <= BACK:
            self._mixed = 0
        if not self._held:
            self._held_since = stamp
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
        stream = self._streams.setdefault(source, Stream(wary=True))
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

    @property
    def trouble(self) -> list[str]:
        """What is wrong with the clocks, a sentence for each source."""
        return [f'the stamps on {source} come from two clocks, {abs(stream.apart):.1f} s apart: do '
                'two programs publish there? Points of the one heard later are refused; stop the '
                'other and clear to go on with it'
                for source, stream in self._streams.items() if stream.apart]

    def _expect_all(self) -> None:
        for stream in self._streams.values():
            stream.expected = True

    def end(self) -> list[T]:
        """Return what is still held; there is nothing more to come."""
        return [sample for stream in self._streams.values() for sample in stream.end()]
