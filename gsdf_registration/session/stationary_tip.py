# SPDX-License-Identifier: Apache-2.0
"""A tip that rests: the mean of its last moments is a landmark or a verification point."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.config import LandmarksConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import AGREEING

# remembered of a source: 2 s at 10 kHz; bounds the memory whatever the stamps say
MOST_SAMPLES = 20_000
# a tenth of the samples may be wild readings, which a tracker strews in; they are left out
MOST_STRAYS = 0.1


@dataclass(frozen=True)
class StationaryTip:
    """Where a tip rested: mean of its samples, m, and how far they lay from it (RMS, largest)."""

    position: Array     # (3,) m, frame of the session
    spread_rms: float
    spread_max: float
    samples: int
    stamp: float        # of the last sample, s
    source: int
    since: float        # it has been near that place all the time from here on, s


class StationaryTipDetector:
    """
    Remembers the last moments of every source, and tells which tip rests and where.

    Several probes may be in view, one of them lying on a table: of all that rest, the one that came
    to rest last is meant.
    """

    def __init__(self, config: LandmarksConfig) -> None:
        """Remember ``config.dwell`` s; samples within ``config.radius`` of their mean rest."""
        self.config = config
        self._sources: dict[int, _Trail] = {}

    def add(self, stamp: float, position: tuple[float, float, float], source: int = 0,
            arrival: float | None = None) -> None:
        """Take in a sound sample, stamps of a source rising; seconds and metres."""
        trail = self._sources.get(source)
        if trail is None:
            trail = self._sources[source] = _Trail(stamp, position)
        trail.add(stamp, position, arrival, self.config)

    def rest(self, now: float | None = None) -> StationaryTip:
        """
        Return where the tip rests.

        Parameters
        ----------
        now : float, optional
            Time on the clock of the arrivals, s; a source silent for more than ``dwell`` is then
            left out.

        Raises
        ------
        InputError
            When no tip is seen, not for long enough, or it moves.

        """
        dwell, radius = self.config.dwell, self.config.radius
        trails = [(source, trail) for source, trail in self._sources.items()
                  if now is None or trail.arrival is None or now - trail.arrival <= dwell]
        if not trails:
            raise InputError(
                'no probe tip is seen; bring the probe into view of the tracker, hold it still')
        long_enough = [(source, trail) for source, trail in trails if trail.lasts(dwell)]
        if not long_enough:
            raise InputError(
                f'the tip has not been seen for {dwell:g} s without a break; hold it still '
                'in view and try again')
        rests = [trail.mean(source, dwell, radius) for source, trail in long_enough]
        resting = [rest for rest in rests if rest.spread_max <= radius]
        if not resting:
            nearest = min(rest.spread_max for rest in rests)
            raise InputError(
                f'the tip moves: {1e3 * nearest:.1f} mm within the last {dwell:g} s,'
                f' {1e3 * radius:.1f} mm allowed; hold it still and try again')
        return min(resting, key=lambda rest: rest.stamp - rest.since)


class _Trail:
    """The last samples of one source."""

    def __init__(self, stamp: float, position: tuple[float, float, float]) -> None:
        self.samples: deque[tuple[float, tuple[float, float, float]]] = deque(maxlen=MOST_SAMPLES)
        self.arrival: float | None = None
        self._anchor, self._anchor_stamp = position, stamp
        # the last samples in a row that are not near it
        self._away: list[tuple[float, tuple[float, float, float]]] = []

    def add(self, stamp: float, position: tuple[float, float, float], arrival: float | None,
            config: LandmarksConfig) -> None:
        samples = self.samples
        if samples and stamp - samples[-1][0] > 0.5 * config.dwell:
            samples.clear()     # lost meanwhile: nobody knows where the tip was
        samples.append((stamp, position))
        while len(samples) > 1 and samples[1][0] <= stamp - config.dwell:
            samples.popleft()   # the first one left is just as old as the dwell, or older
        self.arrival = arrival
        near = 2.0 * config.radius
        if math.dist(position, self._anchor) <= near:
            self._away.clear()
            return
        self._away.append((stamp, position))
        if len(self._away) >= AGREEING:     # it went away with the first of them
            (self._anchor_stamp, self._anchor), *rest = self._away
            self._away = [sample for sample in rest if math.dist(sample[1], self._anchor) > near]

    def lasts(self, dwell: float) -> bool:
        return self.samples[0][0] <= self.samples[-1][0] - dwell

    def mean(self, source: int, dwell: float, radius: float) -> StationaryTip:
        """Return the mean over the dwell, a few strays left out, and how far it spreads."""
        last = self.samples[-1][0]
        positions = np.array(
            [position for stamp, position in self.samples if stamp >= last - dwell])
        off = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
        # not where it begins or ends: there the tip has not come yet, or goes
        if max(off[0], off[-1]) <= radius and np.mean(off > radius) <= MOST_STRAYS:
            positions = positions[off <= radius]
        mean = positions.mean(axis=0)
        distances = np.linalg.norm(positions - mean, axis=1)
        return StationaryTip(mean, float(np.sqrt(np.mean(distances**2))), float(distances.max()),
                    len(positions), last, source, self._anchor_stamp)
