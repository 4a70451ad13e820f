# SPDX-License-Identifier: Apache-2.0
"""What a probe delivers: a sample, why it may be rejected, and the points that are kept."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from gsdf_registration.common.rigid import Array

# This many samples in a row that agree outweigh those before: a single reading may be wrong
AGREEING = 3


class Sample(NamedTuple):
    """A position of the tip as it comes in."""

    stamp: float                    # s
    position: Sequence[float]       # (3,) m
    frame_id: str
    source: str
    arrival: float | None = None    # s, our clock
    quality: float | None = None    # m
    stroke: int = 0                 # number that a recording gives it


class Rejection(str, Enum):
    """Why a point was not kept."""

    NOT_FINITE = 'not_finite'
    WRONG_FRAME = 'wrong_frame'
    NO_REFERENCE = 'no_reference'   # no pose of the reference array at its stamp
    NOT_MONOTONIC = 'not_monotonic'
    STALE = 'stale'
    POOR_QUALITY = 'poor_quality'
    NOT_COLLECTING = 'not_collecting'
    TOUCHED = 'touched'     # of a tip resting for a landmark or a verification: not for the fit
    DUPLICATE = 'duplicate'
    TOO_FAST = 'too_fast'
    FULL = 'full'

    def __str__(self) -> str:
        """Return the lower-case word used in JSON, logs and status."""
        return self.value

    @property
    def is_of_sample(self) -> bool:
        """Whether the sample itself is at fault: good for nothing, not even a landmark."""
        return self in _OF_SAMPLE


_OF_SAMPLE = frozenset({Rejection.NOT_FINITE, Rejection.WRONG_FRAME, Rejection.NO_REFERENCE,
                        Rejection.NOT_MONOTONIC, Rejection.STALE, Rejection.POOR_QUALITY})
Position = tuple[float, float, float]


class Points(NamedTuple):
    """Collected points, row by row in the order they came."""

    positions: Array        # (n, 3) m, frame of the session
    stamps: Array           # (n,) s, clock of their source
    strokes: np.ndarray     # (n,) int32 from 1, a number missing after an undo; rising in a source
    sources: np.ndarray     # (n,) int32
