# SPDX-License-Identifier: Apache-2.0
"""
Where a body was at a given time: its poses by stamp, interpolated, never extrapolated.

The reference array fixed to the bone is one such body, a moving frame of /tf another.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from enum import Enum

import numpy as np

from gsdf_registration.common.rigid import (
    FARTHEST,
    Array,
    from_rt,
    is_rigid,
    rotation_exp,
    rotation_log,
)
from gsdf_registration.tracking.clock import BACK, Stream

KEPT = 10.0         # s of poses remembered, as tf2 does
MOST = 20_000       # of them; bounds the memory whatever the stamps say


class LookupStatus(Enum):
    """Why there is no pose at a stamp."""

    NOT_YET = 'a later one may still come'
    NEVER = 'it was not seen before or after, or not for too long in between'


def is_believable(T: Array) -> bool:
    """Tell whether ``T`` (4, 4), m, is a rigid motion within the reach of any tracker."""
    return is_rigid(T) and bool(np.abs(T[:3, 3]).max() < FARTHEST)


class PoseBuffer:
    """
    Poses ``T_a_b`` (4, 4), m, of a body b in one frame a; not thread-safe.

    A clock that goes back starts it anew; a pose that alone is late is passed over.
    """

    def __init__(self) -> None:
        self._stream: Stream[tuple[float, Array]] = Stream()
        self._forget()

    def _forget(self) -> None:
        self._stamps: list[float] = []
        self._poses: list[Array] = []
        self._turns: list[Array | None] = []    # rotation vector to the next pose, once asked for

    @property
    def newest(self) -> float:
        """Stamp of the latest pose, s; -inf without any."""
        return self._stamps[-1] if self._stamps else -math.inf

    def add(self, stamp: float, T: Array) -> str:
        """Take in a pose stamped ``stamp``, s; return why not, or an empty string."""
        if not (math.isfinite(stamp) and is_believable(T)):
            return 'is no rigid motion'
        taken = self._stream.take(stamp, (stamp, T))
        if taken.back:
            self._forget()
        refusal = 'has a stamp that leaps' if taken.strays else ''
        for stamp, T in taken.going_on:
            if stamp > self.newest:
                self._append(stamp, T)
            else:
                refusal = 'is not later than the one before'
        return refusal

    def _append(self, stamp: float, T: Array) -> None:
        self._stamps.append(stamp)
        self._poses.append(T)
        self._turns.append(None)
        # in large pieces, for each costs as much as the buffer is long
        if stamp - self._stamps[0] > 2.0 * KEPT or len(self._stamps) > MOST:
            old = max(bisect_left(self._stamps, stamp - KEPT), len(self._stamps) - MOST // 2)
            del self._stamps[:old], self._poses[:old], self._turns[:old]

    def rewind(self, stamp: float) -> None:
        """Forget all poses if they are of the time before the clock went back to ``stamp``, s."""
        if self._stream.newest > stamp + BACK:
            self._forget()
            self._stream.expected = True

    def at(self, stamp: float, max_gap: float) -> Array | LookupStatus:
        """
        Return the pose at ``stamp``, s.

        Between the two poses that bracket it the translation is linear in time and the rotation
        goes the shortest way at constant speed (slerp, Shoemake 1985).

        Parameters
        ----------
        stamp : float
        max_gap : float
            Time between the two poses at most, s.

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
        return self._between(i, (stamp - stamps[i]) / (stamps[i + 1] - stamps[i]))

    def _between(self, i: int, share: float) -> Array:
        """Return the pose at a share of the way from pose i to the next."""
        a, b, turn = self._poses[i], self._poses[i + 1], self._turns[i]
        if turn is None:
            turn = self._turns[i] = rotation_log(a[:3, :3].T @ b[:3, :3])
        return from_rt(a[:3, :3] @ rotation_exp(share * turn),
                       a[:3, 3] + share * (b[:3, 3] - a[:3, 3]))
