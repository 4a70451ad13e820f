# SPDX-License-Identifier: Apache-2.0
"""
Buffer of the poses of a moving frame: interpolates between stamps, never extrapolates.

It is used for the reference array fixed to the bone and for moving frames of /tf.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from enum import Enum

import numpy as np

from gsdf_registration.common.rigid import (
    MAX_COORDINATE,
    Array,
    from_rt,
    is_rigid,
    rotation_exp,
    rotation_log,
)
from gsdf_registration.tracking.clock import BACK, StampFilter

DURATION = 10.0     # s of poses kept, as in tf2
MAX_POSES = 20_000  # bounds the memory whatever the stamps are


class LookupStatus(Enum):
    """Why there is no pose at a stamp."""

    NOT_YET = 'a later pose may still arrive'
    NEVER = 'no pose before or after the stamp, or too large a gap between them'


def is_plausible(T: Array) -> bool:
    """Return whether ``T`` (4, 4), m, is a rigid motion within the range of any tracker."""
    return is_rigid(T) and bool(np.abs(T[:3, 3]).max() < MAX_COORDINATE)


class PoseBuffer:
    """
    Poses ``T_a_b`` (4, 4), m, of a frame b in one frame a; not thread-safe.

    If the clock goes back, the buffer is cleared. A single late pose is ignored.
    """

    def __init__(self) -> None:
        self._filter: StampFilter[tuple[float, Array]] = StampFilter()
        self._clear()

    def _clear(self) -> None:
        self._stamps: list[float] = []
        self._poses: list[Array] = []
        self._turns: list[Array | None] = []    # rotation vector to the next pose, when computed

    @property
    def newest(self) -> float:
        """Stamp of the latest pose, s; -inf if there is none."""
        return self._stamps[-1] if self._stamps else -math.inf

    def add(self, stamp: float, T: Array) -> str:
        """Add a pose stamped ``stamp``, s; return why it was rejected, or an empty string."""
        if not (math.isfinite(stamp) and is_plausible(T)):
            return 'is not a rigid motion'
        check = self._filter.add(stamp, (stamp, T))
        if check.went_back:
            self._clear()
        reason = 'has a stamp that jumps' if check.outliers else ''
        for stamp, T in check.accepted:
            if stamp > self.newest:
                self._append(stamp, T)
            else:
                reason = 'is not later than the one before'
        return reason

    def _append(self, stamp: float, T: Array) -> None:
        self._stamps.append(stamp)
        self._poses.append(T)
        self._turns.append(None)
        # drop old poses in large blocks: each deletion is linear in the length of the buffer
        if stamp - self._stamps[0] > 2.0 * DURATION or len(self._stamps) > MAX_POSES:
            old = max(bisect_left(self._stamps, stamp - DURATION),
                      len(self._stamps) - MAX_POSES // 2)
            del self._stamps[:old], self._poses[:old], self._turns[:old]

    def rewind(self, stamp: float) -> None:
        """Drop all poses if they are later than ``stamp``, s, to which the clock went back."""
        if self._filter.newest > stamp + BACK:
            self._clear()
            self._filter.expect_jump = True

    def at(self, stamp: float, max_gap: float) -> Array | LookupStatus:
        """
        Return the pose at ``stamp``, s.

        Between the two neighbouring poses the translation is interpolated linearly and the rotation
        by slerp (Shoemake 1985).

        Parameters
        ----------
        stamp : float
        max_gap : float
            Maximum time between the two poses, s.

        Returns
        -------
        (4, 4) float, or LookupStatus

        """
        stamps = self._stamps
        i = bisect_right(stamps, stamp) - 1
        if i >= 0 and stamps[i] == stamp:
            return self._poses[i]
        if i == len(stamps) - 1:
            return LookupStatus.NOT_YET
        if i < 0 or stamps[i + 1] - stamps[i] > max_gap:
            return LookupStatus.NEVER
        return self._interpolate(i, (stamp - stamps[i]) / (stamps[i + 1] - stamps[i]))

    def _interpolate(self, i: int, ratio: float) -> Array:
        """Return the pose at ``ratio``, in [0, 1], between pose i and the next."""
        a, b, turn = self._poses[i], self._poses[i + 1], self._turns[i]
        if turn is None:
            turn = self._turns[i] = rotation_log(a[:3, :3].T @ b[:3, :3])
        return from_rt(a[:3, :3] @ rotation_exp(ratio * turn),
                       a[:3, 3] + ratio * (b[:3, 3] - a[:3, 3]))
