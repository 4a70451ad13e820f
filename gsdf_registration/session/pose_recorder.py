# SPDX-License-Identifier: Apache-2.0
"""Poses of a body, recorded while an operator turns it about a point that stays still."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from gsdf_registration.common.rigid import Array
from gsdf_registration.common.tool_pose import ToolPose

MAX_POSES = 6000    # 100 s at 60 Hz; of more, every other one is kept: a search takes about 1 s


class PoseRecorder:
    """
    The poses of one body in the order received.

    Attributes
    ----------
    angle : rad, largest rotation between the first pose and another

    """

    def __init__(self) -> None:
        self.angle = 0.0
        self._rows: list[tuple[float, ...]] = []    # stamp and pose
        self._received = 0
        self._stride = 1        # one of so many is kept

    def __len__(self) -> int:
        """Return the number of poses kept."""
        return len(self._rows)

    def add(self, stamp: float, pose: ToolPose) -> None:
        """Add a valid pose with its stamp, s."""
        self._received += 1
        if (self._received - 1) % self._stride:
            return
        self._rows.append((stamp, *pose))
        if len(self._rows) == MAX_POSES:
            self._rows, self._stride = self._rows[::2], 2 * self._stride
        cosine = abs(sum(a * b for a, b in zip(self._rows[0][4:], pose[3:])))
        self.angle = max(self.angle, 2.0 * math.acos(min(cosine, 1.0)))

    @property
    def stamps(self) -> Array:
        """Stamps (n,), s."""
        return self._table()[:, 0]

    def matrices(self) -> Array:
        """Return the poses (n, 4, 4), m."""
        table = self._table()
        return _matrices(Rotation.from_quat(table[:, 4:]), table[:, 1:4])

    def seen_from(self, body: PoseRecorder, max_gap: float) -> tuple[Array, Array]:
        """
        Return stamps (m,) and poses (m, 4, 4) in the frame of another body that was recorded.

        Its poses are interpolated at the stamps of these.  Those that are not between two poses of
        the body at most ``max_gap``, s, apart are left out.
        """
        other = body._table()
        other = other[np.unique(other[:, 0], return_index=True)[1]]
        if len(other) < 2:
            return np.zeros(0), np.zeros((0, 4, 4))
        times, mine = other[:, 0], self._table()
        after = np.clip(np.searchsorted(times, mine[:, 0], side='right'), 1, len(times) - 1)
        known = ((mine[:, 0] >= times[0]) & (mine[:, 0] <= times[-1])
                 & (times[after] - times[after - 1] <= max_gap))
        mine = mine[known]
        if not len(mine):
            return np.zeros(0), np.zeros((0, 4, 4))
        turn = Slerp(times, Rotation.from_quat(other[:, 4:]))(mine[:, 0]).inv()
        place = np.stack([np.interp(mine[:, 0], times, other[:, k]) for k in (1, 2, 3)], axis=1)
        return mine[:, 0], _matrices(turn * Rotation.from_quat(mine[:, 4:]),
                                     turn.apply(mine[:, 1:4] - place))

    def _table(self) -> Array:
        return np.array(self._rows, dtype=np.float64).reshape(-1, 8)


def _matrices(turns: Rotation, places: Array) -> Array:
    T = np.tile(np.eye(4), (len(places), 1, 1))
    T[:, :3, :3] = turns.as_matrix()
    T[:, :3, 3] = places
    return T
