# SPDX-License-Identifier: Apache-2.0
"""
A session as plain values, bound to its bone: the content of a session file.

SI units, frames by name.  ``points`` is a structured array with a row for each point: its stroke
(from 1), the index of its source in ``sources``, its stamp, its position in frame
``frames.points``, and, if the accepted registration used it, its residual (NaN: left out as an
outlier) and its weight.
"""

from __future__ import annotations

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
from gsdf_registration.common.tool_pose import NOT_UNIT, ToolPose, is_valid
from gsdf_registration.session.air import ROW_SIZES, Row
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

# columns of each field of `Points`, in the order of the event 'point', and those of the fit
COLUMNS = {'strokes': ('stroke',), 'sources': ('source',), 'stamps': ('stamp',),
           'positions': ('x', 'y', 'z'), 'tools': tuple(f'tool_{name}' for name in (
               'x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'))}
FIT = ('residual', 'weight')
POINT_COLUMNS = tuple(name for names in COLUMNS.values() for name in names)
OPTIONAL = (*COLUMNS['tools'], *FIT)    # left out if they are unknown for every point
WHOLE = ('stroke', 'source')            # int32; other columns are float64
NAMES = (*POINT_COLUMNS, *FIT)
ROW = np.dtype([(name, '<i4' if name in WHOLE else '<f8') for name in NAMES])
FIT_ROW = np.dtype([(name, '<f8') for name in FIT])


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
    tip: list[float]                    # ``probe.tip`` that the positions were computed with
    air: list[Row]                      # where the probe was in the air
    tip_radius: float = 0.0             # m, ``probe.tip_radius`` that the pose was found with
    tip_error: float = 0.0              # m, ``probe.tip_error`` of this tip

    def to_dict(self, config: Config) -> dict[str, Any]:
        """Return the record with settings and versions: plain values, and the rows of points."""
        return empty_record(self.model_sha256) | {
            'versions': {'gsdf_registration': __version__, 'python': platform.python_version(),
                         'numpy': np.__version__, 'numba': numba.__version__},
            'frames': {'points': self.frame_id, 'pose': self.pose_frame_id,
                       'bone': config.bone_frame},
            'collecting': self.collecting, 'sources': self.source_names,
            'rejected': self.rejected, 'landmarks': plain(self.landmarks),
            'verifications': plain(self.verifications), 'result': result_to_dict(self.result),
            'pose_result': result_to_dict(self.pose_result), 'parameters': config.flat(),
            'air': [list(row) for row in self.air],
            'points': _rows(self.points, self.residuals, self.weights)}

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
                landmarks=[landmark_from(item) for item in record['landmarks']],
                verifications=[verification_from(item) for item in record['verifications']],
                tip=_tip(record['parameters'].get('probe.tip', [])),
                air=[_air_row(row) for row in record.get('air', [])],
                tip_radius=number(record['parameters'].get('probe.tip_radius', 0.0)),
                tip_error=number(record['parameters'].get('probe.tip_error', 0.0)),
                result=result_from_dict(record['result']), pose_result=accepted,
                pose_frame_id=text(record['frames']['pose']))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(f'the session is damaged: {type(error).__name__} {error}') from None


def empty_record(model_sha256: str | None) -> dict[str, Any]:
    """Return the record of an empty session, with all keys of a record."""
    return {'versions': {}, 'model_sha256': model_sha256,
            'frames': {'points': None, 'pose': '', 'bone': ''}, 'collecting': False,
            'sources': [], 'rejected': {}, 'landmarks': [], 'verifications': [], 'result': None,
            'pose_result': None, 'parameters': {}, 'air': [], 'points': np.empty(0, ROW)}


def column(rows: np.ndarray, name: str) -> np.ndarray:
    """Return a column of rows (n,); NaN for an `OPTIONAL` one that is left out."""
    known = name not in OPTIONAL or name in (rows.dtype.names or ())
    return rows[name] if known else np.full(len(rows), np.nan)


def fit_of(residuals: Array, weights: Array) -> np.ndarray:
    """Return the rows of `FIT` for n points; NaN: not registered."""
    rows = np.empty(len(residuals), FIT_ROW)
    rows['residual'], rows['weight'] = residuals.round(7), weights.round(4)
    return rows


def _rows(points: Points, residuals: Array, weights: Array) -> np.ndarray:
    """Return the rows of n points, without the `OPTIONAL` columns of which nothing is known."""
    fit = fit_of(residuals, weights)
    columns = {name: fit[name] for name in FIT}
    for field, names in COLUMNS.items():
        columns |= zip(names, np.atleast_2d(getattr(points, field).T))
    known = [name for name in NAMES
             if name not in OPTIONAL or not np.isnan(columns[name]).all()]
    rows = np.empty(len(residuals), [(name, ROW[name]) for name in known])
    for name in known:
        rows[name] = columns[name]
    return rows


def _columns(rows: np.ndarray, sources: int) -> tuple[Points, Array, Array]:
    """Return points, residuals and weights of rows (n,), of which every value is checked."""
    for name in WHOLE:
        if not ((rows[name] % 1 == 0) & (np.abs(rows[name]) < 2**31)).all():
            raise ValueError(f'a point has no valid {name}')
    points = Points(**{field: _values(rows, names) for field, names in COLUMNS.items()})
    residuals, weights = (np.array(column(rows, name), np.float64) for name in FIT)
    if not (np.isfinite(points.stamps).all()
            and (np.abs(points.positions) < MAX_COORDINATE).all()):
        raise ValueError('a point has no valid stamp or position')
    if not ((points.strokes >= 1) & (points.sources >= 0) & (points.sources < sources)).all():
        raise ValueError('a point has no valid stroke or source')
    tools = points.tools[~np.isnan(points.tools).all(axis=1)]
    if not (np.abs(tools[:, :3]) < MAX_COORDINATE).all() or not (
            np.abs(np.linalg.norm(tools[:, 3:], axis=1) - 1.0) <= NOT_UNIT).all():
        raise ValueError('a point has no valid pose of the tool')
    if np.isinf(residuals).any() or (weights < 0.0).any() or (weights > 1.0).any():
        raise ValueError('a point has no valid residual or weight')
    return points, residuals, weights


def _values(rows: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Return the columns of these names as an array (n,), or (n, k) for k > 1 names."""
    values = np.empty((len(rows), len(names)), ROW[names[0]])
    for place, name in enumerate(names):
        values[:, place] = column(rows, name)
    return values if len(names) > 1 else values[:, 0]


def landmark_from(item: Mapping[str, Any]) -> CapturedLandmark:
    """Return a landmark of a record; raise KeyError, TypeError or ValueError if it is damaged."""
    sigma = number(item.get('sigma_m', 0.0))
    if sigma < 0.0:
        raise ValueError(f'{sigma} is no standard deviation')
    return CapturedLandmark(text(item['name']), array(item['model']), array(item['tracker']),
                            number(item['spread_m']), number(item['stamp']), _tool(item), sigma)


def verification_from(item: Mapping[str, Any]) -> Verification:
    """Return a verification point of a record; raise as `landmark_from`."""
    moved = item['moved_m']
    return Verification(array(item['position']), number(item['distance_m']), number(item['stamp']),
                        count(item['checkpoint']), None if moved is None else number(moved),
                        _tool(item))


def _air_row(values: Any) -> Row:
    """Return a row of `Air`; raise TypeError or ValueError if it is damaged."""
    row = tuple(array(values, (len(values),)).tolist())
    if len(row) not in ROW_SIZES or not all(abs(value) < MAX_COORDINATE for value in row[:3]):
        raise ValueError(f'{values} is no position in the air')
    if len(row) > 3:
        _tool({'tool': row[3:]})
    return row


def _tool(item: Mapping[str, Any]) -> ToolPose | None:
    values = item.get('tool')
    if values is None:
        return None
    x, y, z, qx, qy, qz, qw = array(values, (7,)).tolist()
    if not is_valid((x, y, z, qx, qy, qz, qw)):
        raise ValueError(f'{values} is no pose of a tool')
    return x, y, z, qx, qy, qz, qw


def _tip(values: Any) -> list[float]:
    return [] if values == [] else [float(value) for value in array(values)]
