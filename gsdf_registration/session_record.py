# SPDX-License-Identifier: Apache-2.0
"""A session in plain lists and numbers, bound to its bone: what is saved and loaded."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from gsdf_registration import __version__
from gsdf_registration.collection import Points
from gsdf_registration.config import Config
from gsdf_registration.field import Field
from gsdf_registration.result import InputError, Reason, RegistrationResult, WeakestDirection
from gsdf_registration.rigid import Array, is_rigid
from gsdf_registration.touches import CapturedLandmark, Verification

_PER_POINT = ('residuals_m', 'weights', 'history')      # found anew by registering the same points


@dataclass(frozen=True)
class SessionRecord:
    """All that a session must remember."""

    frame_id: str | None
    source_names: list[str]
    points: Points
    rejected: dict[str, int]
    landmarks: list[CapturedLandmark]
    verifications: list[Verification]
    result: RegistrationResult | None
    pose_result: RegistrationResult | None
    pose_frame_id: str

    def to_dict(self, field: Field, config: Config) -> dict[str, Any]:
        """Return the record with its model, the settings and the version, ready for JSON."""
        head = {
            'version': __version__, 'model_sha256': field.bone_sha256, 'parameters': config.flat()
        }
        return head | {key: plain(value) for key, value in vars(self).items()}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], field: Field) -> SessionRecord:
        """
        Return the record of a session with the bone of ``field``.

        Raises
        ------
        InputError
            When it is of another bone, or damaged.

        """
        if record.get('model_sha256') != field.bone_sha256:
            raise InputError(
                'the session belongs to another bone model; load the model it was made with')
        try:
            return cls(
                frame_id=None if record['frame_id'] is None else str(record['frame_id']),
                source_names=[str(name) for name in record['source_names']],
                points=_points(record['points']),
                rejected={str(cause): int(count) for cause, count in record['rejected'].items()},
                landmarks=[CapturedLandmark(
                    str(item['name']), _array(item['model']), _array(item['tracker']),
                    float(item['spread_m']), float(item['stamp'])) for item in record['landmarks']],
                verifications=[Verification(
                    _array(item['position']), float(item['distance_m']), float(item['stamp']))
                    for item in record['verifications']],
                result=_result(record['result']), pose_result=_result(record['pose_result']),
                pose_frame_id=str(record['pose_frame_id']))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(f'the session is damaged: {type(error).__name__} {error}') from None


def plain(value: Any) -> Any:
    """Return dataclasses, arrays, enums as dicts, lists and numbers; non-finite numbers as None."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Points):
        return {key: column.tolist() for key, column in value._asdict().items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {key: plain(item) for key, item in vars(value).items() if key not in _PER_POINT}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _points(columns: Mapping[str, Any]) -> Points:
    points = Points(np.array(columns['positions'], np.float64).reshape(-1, 3),
                    np.array(columns['stamps'], np.float64), np.array(columns['strokes'], np.int32),
                    np.array(columns['sources'], np.int32))
    if len({len(column) for column in points}) != 1 or not np.isfinite(points.positions).all():
        raise ValueError('its points do not match their stamps and strokes')
    return points


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
        raise ValueError('a registration without a proper pose')
    return result
