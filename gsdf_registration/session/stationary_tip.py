# SPDX-License-Identifier: Apache-2.0
"""Detection of a stationary tip; its mean position is a landmark or a verification point."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.config import LandmarksConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import AGREEING, Position, Sample
from gsdf_registration.common.tool_pose import ToolPose, mean_pose

# of a source: 2 s at 10 kHz; bounds the memory whatever the stamps are
MAX_SAMPLES = 20_000
# share of the samples that may be scattered outliers of the tracker; they are left out of the mean
MAX_OUTLIERS = 0.1


@dataclass(frozen=True)
class StationaryTip:
    """Mean position of a stationary tip, and the distances of its samples from the mean."""

    position: Array     # (3,) m, session frame
    spread_rms: float   # m
    spread_max: float   # m
    samples: int
    stamp: float        # of the last sample, s
    source: int
    since: float        # it has been near that place from here on, s
    tool: ToolPose | None = None    # mean pose of the tool, session frame; None: not received


class StationaryTipDetector:
    """
    Keeps the last samples of every source, and finds the tip that is stationary.

    Several probes may be in view, one of them lying on a table.  Of all stationary tips, the one
    that stopped last is returned.
    """

    def __init__(self) -> None:
        self._sources: dict[int, _RecentSamples] = {}

    def add(self, sample: Sample, source: int, config: LandmarksConfig) -> None:
        """Add a valid sample; the stamps of a source ascend."""
        recent = self._sources.get(source)
        if recent is None:
            recent = self._sources[source] = _RecentSamples(sample)
        recent.add(sample, config)

    def detect(self, config: LandmarksConfig, now: float | None = None) -> StationaryTip:
        """
        Return the stationary tip.

        Parameters
        ----------
        config : LandmarksConfig
            The samples of the last ``dwell`` s must be within ``radius`` of their mean.
        now : float, optional
            Local time, s; a source without samples for more than ``dwell`` is then ignored.

        Raises
        ------
        InputError
            If no tip is seen, it is not seen for long enough, or it moves.

        """
        dwell, radius = config.dwell, config.radius
        seen = [(source, recent) for source, recent in self._sources.items()
                if now is None or recent.arrival is None or now - recent.arrival <= dwell]
        if not seen:
            raise InputError(
                'no probe tip is seen; bring the probe into view of the tracker and hold it still')
        long_enough = [(source, recent) for source, recent in seen if recent.covers(dwell)]
        if not long_enough:
            raise InputError(
                f'the tip has not been seen for {dwell:g} s without a break; hold it still '
                'in view and try again')
        tips = [recent.mean(source, dwell, radius) for source, recent in long_enough]
        stationary = [tip for tip in tips if tip.spread_max <= radius]
        if not stationary:
            nearest = min(tip.spread_max for tip in tips)
            raise InputError(
                f'the tip moves: {1e3 * nearest:.1f} mm within the last {dwell:g} s,'
                f' {1e3 * radius:.1f} mm allowed; hold it still and try again')
        return min(stationary, key=lambda tip: tip.stamp - tip.since)


class _RecentSamples:
    """The last samples of one source, and where it has been since when."""

    def __init__(self, first: Sample) -> None:
        self.samples: deque[tuple[float, Position, ToolPose | None]] = deque(maxlen=MAX_SAMPLES)
        self.arrival: float | None = None
        self._anchor, self._anchor_stamp = first.position, first.stamp
        self._away: list[tuple[float, Position]] = []   # last samples in a row far from the anchor

    def add(self, sample: Sample, config: LandmarksConfig) -> None:
        stamp, position, samples = sample.stamp, sample.position, self.samples
        if samples and stamp - samples[-1][0] > 0.5 * config.dwell:
            samples.clear()     # after a gap: where the tip was meanwhile is unknown
        samples.append((stamp, position, sample.tool))
        while len(samples) > 1 and samples[1][0] <= stamp - config.dwell:
            samples.popleft()   # the first one left is at least as old as the dwell
        self.arrival = sample.arrival
        near = 2.0 * config.radius
        if math.dist(position, self._anchor) <= near:
            self._away.clear()
            return
        self._away.append((stamp, position))
        if len(self._away) >= AGREEING:     # the tip left with the first of them
            (self._anchor_stamp, self._anchor), *rest = self._away
            self._away = [each for each in rest if math.dist(each[1], self._anchor) > near]

    def covers(self, dwell: float) -> bool:
        return self.samples[0][0] <= self.samples[-1][0] - dwell

    def mean(self, source: int, dwell: float, radius: float) -> StationaryTip:
        """Return the mean over the dwell without a few outliers, and the spread about it."""
        last = self.samples[-1][0]
        recent = [each for each in self.samples if each[0] >= last - dwell]
        positions = np.array([position for _, position, _ in recent])
        off = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
        # the first and last samples are no outliers: if they are off, the tip arrives or leaves
        kept = np.ones(len(recent), dtype=bool)
        if max(off[0], off[-1]) <= radius and np.mean(off > radius) <= MAX_OUTLIERS:
            kept = off <= radius
        positions = positions[kept]
        tools = [tool for (_, _, tool), use in zip(recent, kept) if use and tool is not None]
        mean = positions.mean(axis=0)
        distances = np.linalg.norm(positions - mean, axis=1)
        return StationaryTip(mean, float(np.sqrt(np.mean(distances**2))), float(distances.max()),
                             len(positions), last, source, self._anchor_stamp,
                             mean_pose(tools) if tools else None)
