# SPDX-License-Identifier: Apache-2.0
"""A collection, and a tip that is dragged along a line for it."""

from __future__ import annotations

from gsdf_registration.common.config import GateConfig
from gsdf_registration.common.samples import Rejection
from gsdf_registration.session.collection import Collection

RATE = 80.0
SPEED = 0.05    # m/s, of the tip in these tests


def collection(max_points: int = 10_000, frame_id: str = '', **gate: float) -> Collection:
    made = Collection(GateConfig(**gate), max_points, frame_id)
    made.start_stroke()
    return made


def path(index: int) -> tuple[float, float, float]:
    """Return a tip that moves on a line."""
    return (SPEED * index / RATE, 0.0, -1.0)


def drag(target: Collection, count: int, first: int = 0, source: int = 0) -> list[Rejection | None]:
    return [target.add((first + i) / RATE, path(first + i), 'cam', source) for i in range(count)]


def two_strokes(first: int, second: int) -> Collection:
    """Return a stroke and, begun by a call, one that goes on where it ended."""
    made = collection()
    drag(made, first)
    made.start_stroke()
    drag(made, second, first=first)
    return made


def undone(target: Collection) -> int:
    """Undo, and return the number of points that were dropped."""
    stroke = target.undo()
    assert stroke is not None
    return stroke.points
