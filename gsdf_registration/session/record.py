# SPDX-License-Identifier: Apache-2.0
"""
A session as plain lists and numbers, bound to its bone: the content of a session file.

SI units, frames by name.  ``points`` has a row for each point: its stroke (from 1), the index of
its source in ``sources``, its stamp, its position in frame ``frames.points``, and, if the accepted
registration used it, its residual (null: left out as an outlier) and its weight.
"""

from __future__ import annotations

import dataclasses
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from gsdf_registration import __version__
from gsdf_registration.common.config import Config
from gsdf_registration.common.json_values import plain
from gsdf_registration.common.result import InputError, Reason, RegistrationResult, WeakestDirection
from gsdf_registration.common.rigid import Array, is_rigid
from gsdf_registration.common.samples import Points
from gsdf_registration.session.landmark_capture import CapturedLandmark
from gsdf_registration.session.verification import Verification

COLUMNS = ('stroke', 'source', 'stamp', 'x', 'y', 'z', 'residual', 'weight')
STROKE, SOURCE, STAMP, FIT = 0, 1, 2, 6
# fields of a result that a record leaves out; the first two are columns of `points`
_PER_POINT = ('residuals_m', 'weights', 'history')


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

    def to_dict(self, config: Config) -> dict[str, Any]:
        """Return the record with settings and versions, ready for JSON."""
        return empty_record(self.model_sha256) | {
            'versions': {'gsdf_registration': __version__, 'python': platform.python_version(),
                         'numpy': np.__version__, 'numba': numba.__version__},
            'frames': {'points': self.frame_id, 'pose': self.pose_frame_id,
                       'bone': config.bone_frame},
            'collecting': self.collecting, 'sources': self.source_names,
            'rejected': self.rejected, 'landmarks': plain(self.landmarks),
            'verifications': plain(self.verifications), 'result': result_to_dict(self.result),
            'pose_result': result_to_dict(self.pose_result), 'parameters': config.flat(),
            'points': _rows(self.points, fit_of(self.residuals, self.weights))}

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
            return cls(
                model_sha256=record['model_sha256'],
                frame_id=None if frame_id is None else str(frame_id),
                collecting=bool(record['collecting']),
                source_names=[str(name) for name in sources],
                points=points, residuals=residuals, weights=weights,
                rejected={str(cause): int(count) for cause, count in record['rejected'].items()},
                landmarks=[CapturedLandmark(
                    str(item['name']), _array(item['model']), _array(item['tracker']),
                    float(item['spread_m']), float(item['stamp'])) for item in record['landmarks']],
                verifications=[_verification(item) for item in record['verifications']],
                result=_result(record['result']), pose_result=_result(record['pose_result']),
                pose_frame_id=str(record['frames']['pose']))
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


def result_to_dict(result: RegistrationResult | None) -> dict[str, Any] | None:
    """Return a result in plain values, without the fields per point."""
    values: dict[str, Any] | None = plain(result, _PER_POINT)
    return values


def _rows(points: Points, fit: list[list[float | None] | None]) -> list[list[Any]]:
    return [[stroke, source, stamp, *position, *(known or (None, None))]
            for stroke, source, stamp, position, known in zip(
                points.strokes.tolist(), points.sources.tolist(), points.stamps.tolist(),
                points.positions.tolist(), fit)]


def _columns(rows: list[list[Any]], sources: int) -> tuple[Points, Array, Array]:
    """Return points, residuals and weights; None becomes NaN."""
    table = np.array(rows, np.float64).reshape(-1, len(COLUMNS))
    numbers = table[:, [STROKE, SOURCE]]
    if len(table) != len(rows) or not np.isfinite(table[:, :FIT]).all():
        raise ValueError(f'the points are not rows of {", ".join(COLUMNS)}')
    if (numbers % 1.0 != 0.0).any() or not (
            (numbers >= [1.0, 0.0]) & (numbers < [2.0**31, sources])).all():
        raise ValueError('a point has no valid stroke or source')
    return (Points(table[:, 3:FIT].copy(), table[:, STAMP].copy(),
                   table[:, STROKE].astype(np.int32), table[:, SOURCE].astype(np.int32)),
            table[:, FIT].copy(), table[:, FIT + 1].copy())


def _verification(item: Mapping[str, Any]) -> Verification:
    moved = item['moved_m']
    return Verification(_array(item['position']), float(item['distance_m']), float(item['stamp']),
                        int(item['checkpoint']), None if moved is None else float(moved))


def _array(values: Any, shape: tuple[int, ...] = (3,)) -> Array:
    array = np.array(values, np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f'{values} is not an array of {" x ".join(map(str, shape))} numbers')
    return array


def _result(values: Mapping[str, Any] | None) -> RegistrationResult | None:
    if values is None:
        return None
    known = {item.name for item in dataclasses.fields(RegistrationResult)} - set(_PER_POINT)
    values = {key: value for key, value in values.items() if key in known}
    for key, shape in (('T_tracker_bone', (4, 4)), ('covariance', (6, 6))):
        values[key] = None if values[key] is None else _array(values[key], shape)
    weakest = values['weakest_direction']
    if weakest is not None:
        pitch = weakest['pitch_m_per_rad']
        values['weakest_direction'] = WeakestDirection(**{
            **weakest, 'axis': _array(weakest['axis']), 'point': _array(weakest['point']),
            'pitch_m_per_rad': math.inf if pitch is None else pitch})
    result = RegistrationResult(**{**values, 'reason': Reason(values['reason'])})
    if result.success and (result.T_tracker_bone is None or not is_rigid(result.T_tracker_bone)):
        raise ValueError('the registration has no valid pose')
    return result
