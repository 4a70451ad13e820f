# SPDX-License-Identifier: Apache-2.0
"""
Tree of coordinate frames as published on /tf, each with one parent (REP-105).

Moving transforms follow the rules of `PoseBuffer`: interpolated, never extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.rigid import Array, inverse
from gsdf_registration.tracking.pose_buffer import LookupStatus, PoseBuffer, is_plausible


@dataclass
class _Edge:
    """Transform from a frame to its parent."""

    parent: str
    fixed: Array | None     # T_parent_child if it is static, ...
    moving: PoseBuffer      # ... or its poses by stamp


class Frames:
    """The tree of frames; not thread-safe."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, parent: str, child: str, stamp: float, T: Array, fixed: bool = False) -> None:
        """
        Add ``T_parent_child`` (4, 4), m, at ``stamp``, s; ``fixed``: for all times.

        A transform that is not rigid, or from a frame to itself, is ignored.
        """
        if parent == child:
            return
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent:
            edge = _Edge(parent, None, PoseBuffer())
        if fixed and is_plausible(T):
            self._edges[child] = _Edge(parent, T, edge.moving)
        elif not fixed and not edge.moving.add(stamp, T):
            self._edges[child] = _Edge(parent, None, edge.moving)

    def rewind(self, stamp: float) -> None:
        """Drop transforms later than ``stamp``, s, to which the clock went back."""
        for edge in self._edges.values():
            edge.moving.rewind(stamp)

    def connected(self, a: str, b: str) -> bool:
        """Return whether two frames have a common ancestor."""
        return self._path_to_root(a)[-1] == self._path_to_root(b)[-1]

    def at(self, a: str, b: str, stamp: float, max_gap: float) -> Array | LookupStatus:
        """Return ``T_a_b`` (4, 4), m, at ``stamp``, s; see `PoseBuffer.at`."""
        path_a, path_b = self._path_to_root(a), self._path_to_root(b)
        if path_a[-1] != path_b[-1]:
            return LookupStatus.NOT_YET
        # the transforms above the lowest common ancestor are not needed
        while len(path_a) > 1 and len(path_b) > 1 and path_a[-2] == path_b[-2]:
            path_a.pop()
            path_b.pop()
        T_top_a, T_top_b = (self._compose(path, stamp, max_gap) for path in (path_a, path_b))
        if isinstance(T_top_a, LookupStatus):
            return T_top_a
        return T_top_b if isinstance(T_top_b, LookupStatus) else inverse(T_top_a) @ T_top_b

    def _path_to_root(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on to the root."""
        path = [frame]
        while (edge := self._edges.get(path[-1])) is not None and edge.parent not in path:
            path.append(edge.parent)
        return path

    def _compose(self, path: list[str], stamp: float, max_gap: float) -> Array | LookupStatus:
        """Return the motion (4, 4) from the first frame of a path to the last."""
        T = np.eye(4)
        for frame in path[:-1]:
            edge = self._edges[frame]
            step = edge.moving.at(stamp, max_gap) if edge.fixed is None else edge.fixed
            if isinstance(step, LookupStatus):
                return step
            T = step @ T
        return T
