# SPDX-License-Identifier: Apache-2.0
"""A sample of the probe tip, the causes for which it can be rejected, and the collected points."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.tool_pose import ToolPose, is_valid, normalized, tip_position

Position = tuple[float, float, float]

# This many consecutive samples that agree override those before them. One sample may be an outlier.
AGREEING = 3


class Sample(NamedTuple):
    """One position of the probe tip, or one pose of the tool that carries it, as received."""

    stamp: float                    # s, clock of the sender
    # m, in `frame_id`; plain floats. Of the tip; of the origin of the tool, if there is `tool`,
    # until the session applies ``probe.tip``
    position: Position
    frame_id: str
    topic: str                      # topic, tool or file it came from
    arrival: float | None = None    # s, local clock
    quality: float | None = None    # m, error estimate of the tracker
    stroke: int = 0                 # stroke number in a recording, 0 if there is none
    tool: ToolPose | None = None    # pose of the tool in `frame_id`; None: the tip was received


def at_tip(sample: Sample, tip: Sequence[float]) -> Sample:
    """Return a sample at the ``tip`` (3,), m, of its tool; unchanged without a valid pose of it."""
    if sample.tool is None or not is_valid(sample.tool):
        return sample
    tool = normalized(sample.tool)
    return sample._replace(position=tip_position(tool, tip), tool=tool)


class Rejection(str, Enum):
    """The cause for which a sample was rejected."""

    NOT_FINITE = 'not_finite'
    BAD_QUATERNION = 'bad_quaternion'   # the orientation of a tool is not a unit quaternion
    WRONG_FRAME = 'wrong_frame'
    NO_REFERENCE = 'no_reference'   # no pose of the reference array at this stamp
    NOT_MONOTONIC = 'not_monotonic'
    STALE = 'stale'
    LOST = 'lost'           # before the node could take it: its queue was full, or the network
    POOR_QUALITY = 'poor_quality'
    CALIBRATING = 'calibrating'     # used to find the tip of the probe or a joint centre
    NOT_COLLECTING = 'not_collecting'
    TOUCHED = 'touched'     # stationary tip at a landmark or verification point, not for the fit
    UNDONE = 'undone'       # of a stroke that was dropped
    DUPLICATE = 'duplicate'
    TOO_FAST = 'too_fast'
    FULL = 'full'

    def __str__(self) -> str:
        """Return the lower-case name used in JSON, logs and status."""
        return self.value

    @property
    def invalidates_sample(self) -> bool:
        """Whether the sample itself is invalid: it is not used for landmarks either."""
        return self in _INVALID


_INVALID = frozenset({Rejection.NOT_FINITE, Rejection.BAD_QUATERNION, Rejection.WRONG_FRAME,
                      Rejection.NO_REFERENCE, Rejection.NOT_MONOTONIC, Rejection.STALE,
                      Rejection.POOR_QUALITY})


class SampleSink(Protocol):
    """Receives the samples of a stream after they were transformed into the session frame."""

    @property
    def config(self) -> Config:
        """Settings in force."""

    def take(self, sample: Sample) -> bool:
        """Use a sample as it was received, in any frame, for a calibration; return whether so."""

    def add_reference_pose(self, stamp: float, T: Array) -> None:
        """Receive a pose (4, 4), m, of the reference array in the tracker frame."""

    def add(self, sample: Sample) -> Rejection | None:
        """Store a sample; return the cause if it is rejected."""

    def reject(self, sample: Sample, cause: Rejection) -> None:
        """Count a sample that could not be transformed or is out of order."""

    def restart(self, reason: str) -> None:
        """Discard the collected points because the clock of the samples restarted."""


class Points(NamedTuple):
    """Collected points, one row each, in the order received."""

    positions: Array        # (n, 3) m, session frame
    stamps: Array           # (n,) s, clock of the sender
    strokes: np.ndarray     # (n,) int32 from 1, with gaps after an undo, rising within a source
    sources: np.ndarray     # (n,) int32, index of the topic
    tools: Array            # (n, 7) poses of the tool, see `tool_pose`; NaN: the tip was received


def without_tools(positions: Array, stamps: Array, strokes: np.ndarray,
                  sources: np.ndarray) -> Points:
    """Return points (n,) that were received as positions of the tip."""
    return Points(positions, stamps, strokes, sources, np.full((len(stamps), 7), np.nan))


def untimed(positions: Array) -> Points:
    """Return positions (n, 3), m, of which neither stamps nor strokes are known."""
    zeros = np.zeros(len(positions), np.int32)
    return without_tools(positions, zeros.astype(np.float64), zeros, zeros)
