# SPDX-License-Identifier: Apache-2.0
"""The result of a registration as plain values, with every type checked when it is read."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import NoneType, UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from gsdf_registration.common.json_values import plain
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array, is_rigid

# fields of a result that a record leaves out; the first two are columns of `points`
NOT_RECORDED = ('residuals_m', 'weights', 'history', 'considered')
_SHAPES = {'T_tracker_bone': (4, 4), 'covariance': (6, 6)}      # others: (3,)
_LARGEST_COUNT = 2**31
Record = TypeVar('Record')


def result_to_dict(result: RegistrationResult | None) -> dict[str, Any] | None:
    """Return a result in plain values, without the fields that a record leaves out."""
    values: dict[str, Any] | None = plain(result, NOT_RECORDED)
    return values


def result_from_dict(values: Mapping[str, Any] | None) -> RegistrationResult | None:
    """
    Return the result of plain values.

    Raises
    ------
    KeyError, TypeError, ValueError
        If a value is missing, or not of its type.

    """
    if values is None:
        return None
    # files of earlier versions do not have these
    result = _from_dict(RegistrationResult, {'landmarks': [], 'rejected': {}, **values},
                        NOT_RECORDED)
    if result.success and (result.T_tracker_bone is None or not is_rigid(result.T_tracker_bone)):
        raise ValueError('the registration has no valid pose')
    return result


def text(value: Any) -> str:
    """Return a text; raise TypeError if it is none."""
    if not isinstance(value, str):
        raise TypeError(f'{value!r} is no text')
    return value


def number(value: Any) -> float:
    """Return a finite number; raise TypeError or ValueError if it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f'{value!r} is no number')
    if not math.isfinite(value):
        raise ValueError(f'{value!r} is not finite')
    return float(value)


def flag(value: Any) -> bool:
    """Return true or false; raise TypeError if it is neither."""
    if not isinstance(value, bool):
        raise TypeError(f'{value!r} is not true or false')
    return value


def items(value: Any) -> list[Any]:
    """Return a list; raise TypeError if it is none."""
    if not isinstance(value, list):
        raise TypeError(f'{value!r} is no list')
    return value


def count(value: Any) -> int:
    """Return a count; raise TypeError or ValueError if it is none."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f'{value!r} is no count')
    if not 0 <= value < _LARGEST_COUNT:
        raise ValueError(f'{value} is no count')
    return value


def array(values: Any, shape: tuple[int, ...] = (3,)) -> Array:
    """Return an array of finite numbers; raise ValueError or TypeError if it is none."""
    found = np.array(values, np.float64)
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f'{values} is not an array of {" x ".join(map(str, shape))} numbers')
    return found


def _from_dict(kind: type[Record], values: Mapping[str, Any],
               without: tuple[str, ...] = ()) -> Record:
    """Return a dataclass whose fields have the types that they are declared with."""
    hints = get_type_hints(kind)
    return kind(**{each.name: _value(values[each.name], hints[each.name],
                                     _SHAPES.get(each.name, (3,)))
                   for each in dataclasses.fields(kind) if each.name not in without})  # type: ignore[arg-type]


def _value(value: Any, hint: Any, shape: tuple[int, ...]) -> Any:
    if isinstance(hint, UnionType):
        if value is None and NoneType in get_args(hint):
            return None
        (hint,) = (each for each in get_args(hint) if each is not NoneType)
    if hint is float:
        return math.inf if value is None else number(value)     # see `plain`
    if hint is bool:
        return flag(value)
    if hint is int:
        return count(value)
    if hint is str:
        return text(value)
    if hint is Reason:
        return Reason(value)
    if hint == Array:
        return array(value, shape)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return _from_dict(hint, value)
    if get_origin(hint) is tuple:
        return tuple(_value(item, get_args(hint)[0], shape) for item in items(value))
    if get_origin(hint) is dict:
        return {text(key): None if item is None else _value(item, get_args(hint)[1], shape)
                for key, item in value.items()}
    raise TypeError(f'{hint} is no type of a record')
