# SPDX-License-Identifier: Apache-2.0
"""
Where the probe was in the air, which is evidence: no bone is there.

A position counts if the tip went from there to the bone, or came from there, along a path without
jumps and within three seconds.  A reading that the tracker got wrong is on no such path.  Nor is a
position from long before or after a touch, when the bone may have been elsewhere: without a
reference array nothing shows that it moved.

Positions are samples while points are not collected.  Collected points after a lift-off count in
the mixture of the solver.  A tip that rests on the bone may be among the samples: it is not inside
the bone either.  With the poses of a tool and ``probe.shaft``, the shaft behind the tip counts too,
also while the tip is on the bone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.config import GateConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points, Position, Rejection, Sample
from gsdf_registration.common.tool_pose import tip_positions
from gsdf_registration.session.tip_stream import MIN_INTERVAL

CELL = 0.002            # m; one position is kept in each cell
MAX_POSITIONS = 10_000  # further ones are not kept; this bounds memory and files
MAX_STEP = 0.02         # m between consecutive samples of a path
REACH = 3.0             # s between a position and a touch of the bone
WAITING = 4096          # positions of a source from which the tip has not reached the bone yet
SHAFT = np.arange(0.005, 0.1, 0.01)     # m behind the tip: up to there a probe is thin and straight
MAX_POSES = 1000        # poses of the tool whose shaft counts, evenly chosen

Row = tuple[float, ...]     # x y z of the tip, m, followed by the pose of the tool if it is known
ROW_SIZES = (3, 10)


class Air:
    """Positions of the tip in the air, session frame, m, with the pose of the tool if known."""

    def __init__(self) -> None:
        self._cells: set[tuple[int, int, int]] = set()
        self._paths: dict[int, _Path] = {}
        self.rows: list[Row] = []

    def add(self, sample: Sample, source: int, rejection: Rejection | None,
            gate: GateConfig) -> list[Row]:
        """
        Follow the path of the tip; takes a few microseconds.

        Parameters
        ----------
        sample : Sample, with the position of the tip
        source : int
        rejection : why it is not collected, or None
        gate : GateConfig

        Returns
        -------
        list of Row
            Those that were kept now.

        """
        if rejection is not None and (rejection.invalidates_sample or rejection in _NOT_ON_PATH):
            return []
        path = self._paths.setdefault(source, _Path())
        path.step(sample.stamp, sample.position, gate)
        if rejection is None:
            return self._keep(path.touch(sample.stamp))
        if rejection is Rejection.NOT_COLLECTING:
            return self._keep(path.leave(sample.stamp, (*sample.position, *(sample.tool or ()))))
        return []

    def _keep(self, rows: Iterable[Row]) -> list[Row]:
        """Keep the rows in new cells, and return them."""
        kept = []
        for row in rows:
            cell = (math.floor(row[0] / CELL), math.floor(row[1] / CELL), math.floor(row[2] / CELL))
            if cell not in self._cells and len(self.rows) < MAX_POSITIONS:
                self._cells.add(cell)
                self.rows.append(row)
                kept.append(row)
        return kept

    def restore(self, rows: Iterable[Sequence[float]]) -> None:
        """Keep the rows of a saved session instead."""
        self._cells, self._paths, self.rows = set(), {}, []
        self._keep(tuple(row) for row in rows)

    def apply_tip(self, tip: Sequence[float]) -> None:
        """Compute the positions again from the poses of the tool, see `with_tip`."""
        self.restore(with_tip(self.rows, tip))


_NOT_ON_PATH = frozenset({Rejection.TOO_FAST, Rejection.CALIBRATING})


class _Path:
    """The path of the tip of one source since its last jump."""

    def __init__(self) -> None:
        self._last: tuple[float, Position] | None = None
        self._touched = -math.inf       # stamp of the last touch of the bone on this path
        self._waiting: deque[tuple[float, Row]] = deque(maxlen=WAITING)

    def step(self, stamp: float, position: Position, gate: GateConfig) -> None:
        """Go on to ``position``, or begin a path there after a jump or a silence."""
        if self._last is not None:
            apart, elapsed = math.dist(position, self._last[1]), stamp - self._last[0]
            fastest = gate.max_speed * max(elapsed, MIN_INTERVAL)
            if apart > min(MAX_STEP, fastest) or elapsed > gate.max_gap:
                self._touched = -math.inf
                self._waiting.clear()
        self._last = stamp, position

    def touch(self, stamp: float) -> list[Row]:
        """Return the rows from which the tip has come to the bone."""
        self._touched = stamp
        rows = [row for at, row in self._waiting if stamp - at <= REACH]
        self._waiting.clear()
        return rows

    def leave(self, stamp: float, row: Row) -> list[Row]:
        """Return the row if the tip came there from the bone; else it waits for a touch."""
        if stamp - self._touched <= REACH:
            return [row]
        self._waiting.append((stamp, row))
        return []


def with_tip(rows: Iterable[Sequence[float]], tip: Sequence[float]) -> list[Row]:
    """Return the rows with the positions for another ``tip``, (3,) m or empty, of the tool."""
    moved: list[Row] = []
    for row in map(tuple, rows):
        pose = np.array([row[3:]]).reshape(-1, 7)
        moved.append((*tip_positions(pose, tip)[0].tolist(), *row[3:]) if len(pose) else row)
    return moved


def positions(rows: Sequence[Row], points: Points, tip: Sequence[float],
              shaft: Sequence[float]) -> Array:
    """
    Return where tip and shaft were in the air (n, 3), m.

    Parameters
    ----------
    rows : of Row
    points : Points, collected
    tip, shaft : (3,) float or empty
        ``probe.tip``, m, and ``probe.shaft``, in the frame of the tool.

    """
    tips = np.array([row[:3] for row in rows]).reshape(-1, 3)
    if not len(shaft):
        return tips
    tools = np.concatenate([
        np.array([row[3:] for row in rows if len(row) > 3]).reshape(-1, 7), _poses(points)])
    tools = tools[::max(-(-len(tools) // MAX_POSES), 1)]
    origin = np.asarray(tip) if len(tip) else np.zeros(3)
    along = np.asarray(shaft) / np.linalg.norm(shaft)
    return np.concatenate([tips, *(tip_positions(tools, (origin + distance * along).tolist())
                                   for distance in SHAFT)])


def _poses(points: Points) -> Array:
    """Return poses (n, 7) of the tool at points whose neighbours on the stroke are near them."""
    order = np.argsort(points.sources, kind='stable')
    tools = points.tools[order]
    near = ((np.diff(points.strokes[order]) == 0)
            & (np.linalg.norm(np.diff(points.positions[order], axis=0), axis=1) <= MAX_STEP))
    between: NDArray[np.bool_] = np.append(near, False) & np.insert(near, 0, False)
    return np.asarray(tools[between[:len(tools)] & ~np.isnan(tools[:, 0])])
