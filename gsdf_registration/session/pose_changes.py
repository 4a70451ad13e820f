# SPDX-License-Identifier: Apache-2.0
"""A pose that was accepted and is withdrawn, and the initial pose that an operator gives."""

from __future__ import annotations

from typing import NamedTuple

from gsdf_registration.common.rigid import Array
from gsdf_registration.common.withdrawal import Withdrawal


class WithdrawnPose(NamedTuple):
    """The withdrawal of the last accepted registration."""

    reason: Withdrawal
    message: str            # one sentence: what happened, and what to do
    session_id: str         # of the registration; the next likewise
    registration_id: int
    frame_id: str           # of its pose


class InitialPose(NamedTuple):
    """Where to search for the bone first."""

    T_tracker_bone: Array   # (4, 4)
    frame_id: str           # of the points; empty: whatever it is

    def applies_to(self, points_frame: str | None) -> bool:
        """Return whether it is in the frame of the points."""
        return self.frame_id in ('', points_frame)
