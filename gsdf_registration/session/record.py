# SPDX-License-Identifier: Apache-2.0
"""
A session as plain lists and numbers, bound to its bone: the content of a session file.

SI units, frames by name.  ``points`` has a row for each point: its stroke (from 1), the index of
its source in ``sources``, its stamp, its position in frame ``frames.points``, and, if the accepted
registration used it, its residual (null: left out as an outlier) and its weight.
"""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from gsdf_registration import __version__
from gsdf_registration.common.config import Config
from gsdf_registration.common.json_values import plain
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import MAX_COORDINATE, Array
from gsdf_registration.common.samples import Points
from gsdf_registration.session.landmark_capture import CapturedLandmark
from gsdf_registration.session.result_record import (
    array,
    count,
    number,
    result_from_dict,
    result_to_dict,
    text,
)
from gsdf_registration.session.verification import Verification

COLUMNS = ('stroke', 'source', 'stamp', 'x', 'y', 'z', 'residual', 'weight')
STROKE, SOURCE, STAMP, FIT = 0, 1, 2, 6
PART = 1000     # rows converted at a time: Python holds its lock meanwhile


@dataclass(frozen=True)
class SessionRecord:
    """The state of a session without its settings."""

    model_sha256: str | None            # None: no bone was loaded yet
    frame_id: str | None
    collecting: bool
    source_names: list[str]
    points: Points                      # (n,)
    residuals: Array                    # (n,) m, at the accepted registration; NaN: unknown
    weights: Array                      # (n,) NaN: the point was not registered
    rejected: dict[str, int]
    landmarks: list[CapturedLandmark]
    verifications: list[Verification]
    result: RegistrationResult | None
    pose_result: RegistrationResult | None
    pose_frame_id: str

    def to_dict(self, config: Config, packed: bool = False) -> dict[str, Any]:
        """
        Return the record with settings and versions, ready for JSON.

        ``packed``: with the points as text, see `unpacked`; takes a tenth of the time.
        """
        points = _packed if packed else _rows
        return empty_record(self.model_sha256) | {
            'versions': {'gsdf_registration': __version__, 'python': platform.python_version(),
                         'numpy': np.__version__, 'numba': numba.__version__},
            'frames': {'points': self.frame_id, 'pose': self.pose_frame_id,
                       'bone': config.bone_frame},
            'collecting': self.collecting, 'sources': self.source_names,
            'rejected': self.rejected, 'landmarks': plain(self.landmarks),
            'verifications': plain(self.verifications), 'result': result_to_dict(self.result),
            'pose_result': result_to_dict(self.pose_result), 'parameters': config.flat(),
            'points': points(self.points, self.residuals, self.weights)}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], model_sha256: str) -> SessionRecord:
        """
        Return the record of a session with the bone of this hash.

        Raises
        ------
        InputError
            If it belongs to another bone, or is damaged.

        """
        try:
            if record['model_sha256'] not in (None, model_sha256):
                raise InputError(
                    'the session belongs to another bone model; load the one it was recorded with')
            frame_id, sources = record['frames']['points'], record['sources']
            points, residuals, weights = _columns(record['points'], len(sources))
            collecting, accepted = record['collecting'], result_from_dict(record['pose_result'])
            if not isinstance(collecting, bool):
                raise TypeError(f'{collecting!r} is not true or false')
            if accepted is not None and not accepted.success:
                raise ValueError('the accepted registration was refused')
            return cls(
                model_sha256=record['model_sha256'],
                frame_id=None if frame_id is None else text(frame_id), collecting=collecting,
                source_names=[text(name) for name in sources],
                points=points, residuals=residuals, weights=weights,
                rejected={text(cause): count(times) for cause, times in record['rejected'].items()},
                landmarks=[CapturedLandmark(
                    text(item['name']), array(item['model']), array(item['tracker']),
                    number(item['spread_m']), number(item['stamp']))
                    for item in record['landmarks']],
                verifications=[_verification(item) for item in record['verifications']],
                result=result_from_dict(record['result']), pose_result=accepted,
                pose_frame_id=text(record['frames']['pose']))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(f'the session is damaged: {type(error).__name__} {error}') from None


def empty_record(model_sha256: str | None) -> dict[str, Any]:
    """Return the record of an empty session, with all keys of a record."""
    return {'versions': {}, 'model_sha256': model_sha256,
            'frames': {'points': None, 'pose': '', 'bone': ''}, 'collecting': False,
            'sources': [], 'rejected': {}, 'landmarks': [], 'verifications': [], 'result': None,
            'pose_result': None, 'parameters': {}, 'columns': list(COLUMNS), 'points': []}


def fit_of(residuals: Array, weights: Array) -> list[list[float | None] | None]:
    """Return [residual, weight] of each point (n,); None if it was not registered."""
    return [None if weight != weight else [None if residual != residual else residual, weight]
            for residual, weight in zip(residuals.round(7).tolist(), weights.round(4).tolist())]


def unpacked(points: str | list[list[Any]]) -> list[list[Any]]:
    """
    Return ``points`` of a record as rows.

    Packed points are the rows as little-endian float64 in base64; NaN means unknown.
    """
    if not isinstance(points, str):
        return points
    return [[int(stroke), int(source), stamp, x, y, z,
             None if residual != residual else residual, None if weight != weight else weight]
            for stroke, source, stamp, x, y, z, residual, weight in _table(points).tolist()]


def _table(packed: str) -> Array:
    data = np.frombuffer(base64.b64decode(packed, validate=True), '<f8')
    return data.astype(np.float64).reshape(-1, len(COLUMNS))


def _packed(points: Points, residuals: Array, weights: Array) -> str:
    table = np.column_stack([points.strokes, points.sources, points.stamps, points.positions,
                             residuals.round(7), weights.round(4)])
    return base64.b64encode(table.astype('<f8').tobytes()).decode()


def _rows(points: Points, residuals: Array, weights: Array) -> list[list[Any]]:
    rows: list[list[Any]] = []
    for first in range(0, len(residuals), PART):
        part = slice(first, first + PART)
        rows += ([stroke, source, stamp, *position, *(known or (None, None))]
                 for stroke, source, stamp, position, known in zip(
                     points.strokes[part].tolist(), points.sources[part].tolist(),
                     points.stamps[part].tolist(), points.positions[part].tolist(),
                     fit_of(residuals[part], weights[part])))
    return rows


def _columns(rows: list[list[Any]], sources: int) -> tuple[Points, Array, Array]:
    """Return points, residuals and weights; None becomes NaN."""
    table = np.concatenate([np.empty((0, len(COLUMNS))), *(
        np.array(rows[first:first + PART], np.float64) for first in range(0, len(rows), PART))])
    numbers, residuals, weights = table[:, [STROKE, SOURCE]], table[:, FIT], table[:, FIT + 1]
    if not (np.abs(table[:, :FIT]) < [2.0**31, 2.0**31, np.inf, *3 * [MAX_COORDINATE]]).all():
        raise ValueError(f'the points are not rows of {", ".join(COLUMNS)}')
    if (numbers % 1.0 != 0.0).any() or not ((numbers >= [1.0, 0.0])
                                            & (numbers < [2.0**31, sources])).all():
        raise ValueError('a point has no valid stroke or source')
    if np.isinf(residuals).any() or (weights < 0.0).any() or (weights > 1.0).any():
        raise ValueError('a point has no valid residual or weight')
    return (Points(table[:, 3:FIT].copy(), table[:, STAMP].copy(),
                   table[:, STROKE].astype(np.int32), table[:, SOURCE].astype(np.int32)),
            residuals.copy(), weights.copy())


def _verification(item: Mapping[str, Any]) -> Verification:
    moved = item['moved_m']
    return Verification(array(item['position']), number(item['distance_m']), number(item['stamp']),
                        count(item['checkpoint']), None if moved is None else number(moved))
