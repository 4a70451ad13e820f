# SPDX-License-Identifier: Apache-2.0
"""A recording of tip positions, as arrays in SI units in the order received."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.tool_pose import is_valid, normalized, tip_position


class RecordedTransform(NamedTuple):
    """
    A recorded pose of the reference array, or a transform of /tf.

    after : int, number of points received before it
    stamp : float, s
    T_parent_child : (4, 4) float64, m; NaN if the message was not a rigid motion
    parent, child : str, frames; the child of a pose of the reference array is empty
    fixed : bool, whether it is valid for all times, as on /tf_static
    """

    after: int
    stamp: float
    T_parent_child: Array
    parent: str
    child: str = ''
    fixed: bool = False


class RecordedEvent(NamedTuple):
    """
    What an operator did, and when.

    after, transforms : int, number of points and of transforms received before it
    event : OperatorEvent
    """

    after: int
    transforms: int
    event: OperatorEvent


@dataclass(eq=False)
class Recording:
    """
    The recorded positions of the tip.

    positions : (n, 3) float64, m, each in its frame of `frame_ids`; rows that are not finite are
        kept, and rejected later
    stamps : (n,) float64, s, or None if the source has no time
    frame_ids : sequence of n str, or one str for all points
    sources : (n,) int32, index into `source_names`; the default is 0
    source_names : topics, tools or files of the points
    quality : (n,) float64, m, error estimated by the tracker, NaN if unknown; or None
    strokes : (n,) int32, stroke numbers; or None
    tools : (n, 7) float64, poses of the tool, see `common.tool_pose`, whose origins are then in
        `positions`; a row of NaN where the tip was recorded; or None
    transforms : of the reference array and of /tf, in the order received
    dropped : dict, number of samples that the source marks as invalid, by cause
    notes : sentences on defects of the source that could be read anyway
    complete : bool, whether nothing of the source is missing or damaged
    events : what the operator did, in order
    """

    positions: Array
    stamps: Array | None = None
    frame_ids: Sequence[str] = ''
    sources: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    source_names: Sequence[str] = ('',)
    quality: Array | None = None
    strokes: NDArray[np.int32] | None = None
    tools: Array | None = None
    transforms: Sequence[RecordedTransform] = ()
    dropped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    complete: bool = True
    events: Sequence[RecordedEvent] = ()

    def __post_init__(self) -> None:
        """Convert all fields to arrays of equal length; raise `ValueError` if they are invalid."""
        self.positions = _array(self.positions, np.float64, 'positions', (-1, 3))
        n = len(self)
        self.frame_ids = [self.frame_ids] * n if isinstance(self.frame_ids, str) else list(
            self.frame_ids)
        if len(self.frame_ids) != n:
            raise ValueError(f'{len(self.frame_ids)} frame_ids for {n} points')
        self.source_names = list(self.source_names)
        self.sources = _array(self.sources if len(self.sources) else np.zeros(n), np.int32,
                              'sources', (n, ))
        if n and not 0 <= self.sources.min() <= self.sources.max() < len(self.source_names):
            raise ValueError(f'sources point outside the {len(self.source_names)} source_names')
        if self.stamps is not None:
            self.stamps = _array(self.stamps, np.float64, 'stamps', (n,))
            if not np.isfinite(self.stamps).all():
                raise ValueError('stamps are not finite')
        if self.quality is not None:
            self.quality = _array(self.quality, np.float64, 'quality', (n,))
        if self.strokes is not None:
            self.strokes = _array(self.strokes, np.int32, 'strokes', (n,))
        if self.tools is not None:
            self.tools = _array(self.tools, np.float64, 'tools', (n, 7))

    def tip_positions(self, tip: Sequence[float]) -> tuple[Array, int]:
        """Return positions (n, 3) of the tip, m, and how many have no valid tool (NaN)."""
        if self.tools is None:
            return self.positions, 0
        given = ~np.isnan(self.tools).all(axis=1)
        positions, bad = self.positions.copy(), 0
        for row in np.flatnonzero(given):
            x, y, z, qx, qy, qz, qw = self.tools[row].tolist()
            tool = (x, y, z, qx, qy, qz, qw)
            valid = is_valid(tool)
            bad += not valid
            positions[row] = tip_position(normalized(tool), tip) if valid else np.nan
        return positions, bad

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.positions)


def _array(values: Any, dtype: Any, name: str, shape: tuple[int, ...]) -> Any:
    """Return ``values`` as a C-contiguous array of ``shape``, in which -1 is any length."""
    array = np.ascontiguousarray(values, dtype=dtype)
    if array.size == 0 and shape[0] in (-1, 0):
        array = array.reshape((0, *shape[1:]))
    if array.ndim != len(shape) or any(want not in (-1, got)
                                       for want, got in zip(shape, array.shape)):
        raise ValueError(f'{name} has shape {array.shape}, expected {shape}')
    return array


def merge(recordings: Sequence[Recording]) -> Recording:
    """
    Merge recordings in the order of their stamps.

    The order within a recording is kept, so that stamps that go back are still rejected later.
    Recordings without stamps are concatenated. Sources with the same name are merged. Strokes of
    different recordings stay separate; if only some recordings have strokes, each of the others is
    one stroke. Unknown quality becomes NaN. A transform stays after the point that it followed.

    Raises
    ------
    InputError
        If there are no recordings, or only some of them have stamps.

    """
    if not recordings:
        raise InputError('there are no recordings to merge')
    if len({r.stamps is None for r in recordings}) > 1:
        raise InputError(
            'only some of the recordings have stamps, so that they cannot be ordered')
    names = list(dict.fromkeys(name for r in recordings for name in r.source_names))
    sources = [np.array([names.index(name) for name in r.source_names])[r.sources]
               for r in recordings]
    stamps = [r.stamps for r in recordings if r.stamps is not None]
    merged = Recording(
        positions=np.concatenate([r.positions for r in recordings]),
        stamps=np.concatenate(stamps) if stamps else None,
        frame_ids=[frame for r in recordings for frame in r.frame_ids],
        sources=np.concatenate(sources).astype(np.int32), source_names=names,
        quality=_joined_quality(recordings), strokes=_joined_strokes(recordings),
        tools=_joined_tools(recordings),
        dropped=dict(sum((Counter(r.dropped) for r in recordings), Counter())),
        notes=tuple(note for r in recordings for note in r.notes),
        complete=all(r.complete for r in recordings))
    order = np.arange(len(merged))
    if stamps:
        latest_seen = np.concatenate([np.maximum.accumulate(s) for s in stamps])
        order = np.argsort(latest_seen, kind='stable')
        _reorder(merged, order)
    merged.transforms = _joined_transforms(recordings, np.argsort(order))
    return merged


def _reorder(recording: Recording, order: NDArray[np.intp]) -> None:
    """Sort the points of ``recording`` by the indices ``order``."""
    recording.frame_ids = [recording.frame_ids[i] for i in order]
    for name in ('positions', 'stamps', 'sources', 'quality', 'strokes', 'tools'):
        values = getattr(recording, name)
        if values is not None:
            setattr(recording, name, values[order])


def _joined_transforms(recordings: Sequence[Recording],
                       rows: NDArray[np.intp]) -> list[RecordedTransform]:
    """Return all transforms; ``rows`` are the new indices of the concatenated points."""
    joined, first = [], 0
    for r in recordings:
        joined += [each._replace(after=int(rows[first + each.after - 1]) + 1 if each.after else 0)
                   for each in r.transforms]
        first += len(r)
    return sorted(joined, key=lambda each: each.after)


def _joined_quality(recordings: Sequence[Recording]) -> Array | None:
    """Return the concatenated quality, or None if no recording has any."""
    if all(r.quality is None for r in recordings):
        return None
    return np.concatenate(
        [np.full(len(r), np.nan) if r.quality is None else r.quality for r in recordings])


def _joined_tools(recordings: Sequence[Recording]) -> Array | None:
    """Return the concatenated poses of the tools, or None if no recording has any."""
    if all(r.tools is None for r in recordings):
        return None
    return np.concatenate(
        [np.full((len(r), 7), np.nan) if r.tools is None else r.tools for r in recordings])


def _joined_strokes(recordings: Sequence[Recording]) -> NDArray[np.int32] | None:
    """Return the concatenated stroke numbers, distinct between recordings, or None without any."""
    if all(r.strokes is None for r in recordings):
        return None
    joined, offset = [], 0
    for r in recordings:
        strokes = np.zeros(len(r), np.int32) if r.strokes is None else r.strokes
        joined.append(strokes - strokes.min(initial=0) + offset)
        offset = int(joined[-1].max(initial=offset - 1)) + 1
    return np.concatenate(joined)
