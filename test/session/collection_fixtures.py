# SPDX-License-Identifier: Apache-2.0
"""A collection with its settings, and a tip that moves along a line."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsdf_registration.common.config import Config
from gsdf_registration.common.samples import Points, Position, Rejection, Sample
from gsdf_registration.session.collection import Collection

RATE = 80.0
SPEED = 0.05    # m/s, of the tip in these tests


class ConfiguredCollection(Collection):
    """A collection that applies the same settings to every call."""

    def __init__(self, config: Config, frame_id: str = '') -> None:
        super().__init__(frame_id)
        self.config = config

    def add_point(self, stamp: float, position: Position, frame_id: str = 'cam', source: int = 0,
                  **more: Any) -> Rejection | None:
        return self.add(Sample(stamp, position, frame_id, f'/probe_{source}', **more), source,
                        self.config)

    def restore_points(self, points: Points, frame_id: str | None, counts: dict[str, int]) -> None:
        self.restore(points, frame_id, counts, self.config)


def collection(max_points: int = 10_000, frame_id: str = '', **gate: float) -> ConfiguredCollection:
    config = Config.from_flat({'probe.frame_id': frame_id} | {
        f'gate.{name}': value for name, value in gate.items()})
    # fewer points than the settings allow keep the tests short
    made = ConfiguredCollection(dataclasses.replace(config, collect=dataclasses.replace(
        config.collect, max_points=max_points)), frame_id)
    made.start_stroke()
    return made


def path(index: int) -> Position:
    """Return a position of a tip that moves along a line."""
    return (SPEED * index / RATE, 0.0, -1.0)


def drag(target: ConfiguredCollection, count: int, first: int = 0,
         source: int = 0) -> list[Rejection | None]:
    return [target.add_point((first + i) / RATE, path(first + i), source=source)
            for i in range(count)]


def two_strokes(first: int, second: int) -> ConfiguredCollection:
    """Return a stroke and, started by a call, one that continues where it ended."""
    made = collection()
    drag(made, first)
    made.start_stroke()
    drag(made, second, first=first)
    return made


def undone(target: ConfiguredCollection) -> int:
    """Undo, and return the number of points that were dropped."""
    stroke = target.undo()
    assert stroke is not None
    return stroke.points
