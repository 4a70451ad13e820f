# SPDX-License-Identifier: Apache-2.0
"""Samples that a tracker does not report: short drop-outs of a tool, and gaps of the tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array

BURST = 0.1     # s, longest drop-out


@dataclass(frozen=True)
class Losses:
    """
    What is lost.

    dropouts : float, share of the samples of one tool, in bursts of up to 0.1 s
    gaps : float, gaps of the whole tracker per minute, in which no tool is reported
    gap : float, s, time between the samples before and after a gap
    """

    dropouts: float = 0.0
    gaps: float = 0.0
    gap: float = 0.125


def dropout_mask(n: int, lost: int, longest: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return a mask (n,) without exactly ``lost`` samples, in bursts of up to ``longest``."""
    kept = np.ones(n, dtype=bool)
    while (left := lost - int(n - kept.sum())) > 0:
        first = int(rng.integers(0, n))
        kept[first:first + min(left, int(rng.integers(1, longest + 1)))] = False
    return kept


def received(stamps: Array, tools: int, rate: float, losses: Losses,
             rng: np.random.Generator) -> NDArray[np.bool_]:
    """
    Return a mask (tools, n) of the samples that are reported.

    Parameters
    ----------
    stamps : (n,) float, s, of the frames of the tracker, rising
    tools : int
    rate : float, Hz
    losses : Losses
    rng : numpy Generator

    """
    n = len(stamps)
    seen = np.ones(n, dtype=bool)
    minutes = float(np.ptp(stamps)) / 60.0
    # between the samples before and after a gap; the stamps have jitter
    length = losses.gap - 0.5 / rate
    for start in rng.uniform(stamps[0], stamps[-1], rng.poisson(losses.gaps * minutes)):
        first = int(np.searchsorted(stamps, start))
        before = stamps[max(first - 1, 0)]
        seen &= (stamps <= before) | (stamps >= before + length)
    longest = max(round(BURST * rate), 2)
    return np.array([seen & dropout_mask(n, round(losses.dropouts * n), longest, rng)
                     for _ in range(tools)])
