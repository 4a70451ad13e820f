# SPDX-License-Identifier: Apache-2.0
"""
Frames that transforms connect, each hung on one parent (REP-105), and the motion between any two.

The rules are those of the reference array: interpolated between two transforms, never extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.rigid import Array, inverse
from gsdf_registration.tracking.pose_buffer import LookupStatus, PoseBuffer, is_believable


@dataclass
class _Edge:
    """How a frame hangs on its parent."""

    parent: str
    fixed: Array | None     # T_parent_child where it never moves, ...
    moving: PoseBuffer      # ... or where it was when


class Frames:
    """The tree of frames; not thread-safe."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, parent: str, child: str, stamp: float, T: Array, fixed: bool = False) -> None:
        """
        Take in ``T_parent_child`` (4, 4), m, at ``stamp``, s, or for all times if ``fixed``.

        One that is no rigid motion, or of a frame in itself, is passed over.
        """
        if parent == child:
            return
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent:
            edge = _Edge(parent, None, PoseBuffer())
        if fixed and is_believable(T):
            self._edges[child] = _Edge(parent, T, edge.moving)
        elif not fixed and not edge.moving.add(stamp, T):
            self._edges[child] = _Edge(parent, None, edge.moving)

    def rewind(self, stamp: float) -> None:
        """Forget what is of the time before the clock went back to ``stamp``, s."""
        for edge in self._edges.values():
            edge.moving.rewind(stamp)

    def connect(self, a: str, b: str) -> bool:
        """Tell whether transforms lead from one frame to the other."""
        return self._way_up(a)[-1] == self._way_up(b)[-1]

    def at(self, a: str, b: str, stamp: float, max_gap: float) -> Array | LookupStatus:
        """Return ``T_a_b`` (4, 4), m, at ``stamp``, s; see `PoseBuffer.at`."""
        way_a, way_b = self._way_up(a), self._way_up(b)
        if way_a[-1] != way_b[-1]:
            return LookupStatus.NOT_YET
        # what lies above the frame where the two ways meet does not matter
        while len(way_a) > 1 and len(way_b) > 1 and way_a[-2] == way_b[-2]:
            way_a.pop()
            way_b.pop()
        T_top_a, T_top_b = (self._climb(way, stamp, max_gap) for way in (way_a, way_b))
        if isinstance(T_top_a, LookupStatus):
            return T_top_a
        return T_top_b if isinstance(T_top_b, LookupStatus) else inverse(T_top_a) @ T_top_b

    def _way_up(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on to the root."""
        way = [frame]
        while (edge := self._edges.get(way[-1])) is not None and edge.parent not in way:
            way.append(edge.parent)
        return way

    def _climb(self, way: list[str], stamp: float, max_gap: float) -> Array | LookupStatus:
        """Return the motion that leads from the first frame of a way to the last."""
        T = np.eye(4)
        for frame in way[:-1]:
            edge = self._edges[frame]
            step = edge.moving.at(stamp, max_gap) if edge.fixed is None else edge.fixed
            if isinstance(step, LookupStatus):
                return step
            T = step @ T
        return T
