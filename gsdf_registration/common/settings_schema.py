# SPDX-License-Identifier: Apache-2.0
"""Declare a setting with its description and range, and validate a value for it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any

from gsdf_registration.common.result import InputError

MAX_SHOWN = 100     # characters of a value in a message


def setting(default: Any, description: str, unit: str = '', low: float | None = None,
            high: float | None = None, choices: tuple[str, ...] = (), fixed: bool = False,
            items: type = str) -> Any:
    """
    Return a dataclass field for a setting.

    Parameters
    ----------
    default : bool, int, float, str or list
    description : str, shown in config/registration.yaml and as the ROS parameter description
    unit : str
    low, high : float, both ends of the valid range are included
    choices : of str, the valid values
    fixed : bool, whether a change takes effect only when the node is configured again
    items : of a list, the type of its items: str or float

    """
    metadata = {'description': description, 'unit': unit, 'low': low, 'high': high,
                'choices': choices, 'fixed': fixed, 'items': items}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata=metadata)
    return field(default=default, metadata=metadata)


def default_value(declared: dataclasses.Field[Any]) -> Any:
    """Return the default value of a field made by `setting`."""
    factory = declared.default_factory
    return declared.default if factory is dataclasses.MISSING else factory()


def flatten(values: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the dotted name and the value of every leaf of nested mappings."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', value


def validate(name: str, value: Any, declared: dataclasses.Field[Any]) -> Any:
    """
    Return the value converted to the type of the setting.

    Raises
    ------
    InputError
        If the type is wrong, a number is not finite or out of range, or a choice is unknown.

    """
    default = default_value(declared)
    if isinstance(default, list):
        return _validate_list(name, value, declared.metadata['items'])
    kind = type(default)
    if not _has_type(value, kind):
        wanted = {bool: 'a bool', str: 'a str', int: 'a whole number',
                  float: 'a finite number'}[kind]
        raise InputError(f'{name} must be {wanted}, not {shown(value)}')
    low, high, unit, choices = (declared.metadata[key] for key in ('low', 'high', 'unit',
                                                                   'choices'))
    if low is not None and not low <= value <= high:
        raise InputError(f'{name} must lie in [{low:g}, {high:g}] {unit}'.rstrip()
                         + f', not {value:g}')
    if choices and value not in choices:
        raise InputError(f'{name} must be one of {", ".join(choices)}, not '
                         f'"{shortened(value)}"')
    return kind(value)


def _validate_list(name: str, value: Any, kind: type) -> list[Any]:
    """Return a list whose items are of this type."""
    is_list = isinstance(value, (list, tuple)) or hasattr(value, 'tolist')
    if not is_list or not all(_has_type(item, kind) for item in value):
        raise InputError(f'{name} must be a list of {kind.__name__}, not {shown(value)}')
    return [kind(item) for item in value]


def _has_type(value: Any, kind: type) -> bool:
    """Return whether a value can be converted to ``kind`` without loss; NaN and inf cannot."""
    if kind in (bool, str):
        return isinstance(value, kind)
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value) and (kind is float or value == int(value))
    except OverflowError:       # an int beyond the range of float
        return False


def shortened(text: str) -> str:
    """Return a text for a message."""
    return text if len(text) <= MAX_SHOWN else f'{text[:MAX_SHOWN]}...'


def shown(value: Any) -> str:
    """Return a value for a message, as Python writes it."""
    try:
        return shortened(repr(value))
    except (ValueError, RecursionError):    # a number of too many digits; lists nested too deeply
        return f'a value of type {type(value).__name__} that is too long to show'
