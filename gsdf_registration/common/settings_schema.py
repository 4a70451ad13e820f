# SPDX-License-Identifier: Apache-2.0
"""How a setting is declared in `config`, and how a value for it is checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any

from gsdf_registration.common.result import InputError


def declared(default: Any, description: str, unit: str = '', low: float | None = None,
             high: float | None = None, choices: tuple[str, ...] = (), fixed: bool = False) -> Any:
    """Declare a field with what a ROS parameter needs; ``fixed``: read at configuring."""
    about = {'description': description, 'unit': unit, 'low': low, 'high': high,
             'choices': choices, 'fixed': fixed}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata=about)
    return field(default=default, metadata=about)


def default_of(setting: dataclasses.Field[Any]) -> Any:
    """Return the default value of a field made by `declared`."""
    factory = setting.default_factory
    return setting.default if factory is dataclasses.MISSING else factory()


def flattened(values: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings by dotted name."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flattened(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', value


def _fits(value: Any, kind: type) -> bool:
    """Tell whether a value can stand for a bool, str, int or float; numbers must be finite."""
    if kind in (bool, str):
        return isinstance(value, kind)
    return (isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
            and (kind is float or value == int(value)))


def checked(name: str, value: Any, setting: dataclasses.Field[Any]) -> Any:
    """Return the value in its declared type, or raise InputError."""
    about = setting.metadata
    default = default_of(setting)
    if isinstance(default, list):
        item = float if name.endswith('positions') else str
        is_list = isinstance(value, (list, tuple)) or hasattr(value, 'tolist')
        if not is_list or not all(_fits(v, item) for v in value):
            raise InputError(f'{name} must be a list of {item.__name__}, not {value!r}')
        return [item(v) for v in value]
    kind = type(default)
    if not _fits(value, kind):
        wanted = {bool: 'a bool', str: 'a str', int: 'a whole number',
                  float: 'a finite number'}[kind]
        raise InputError(f'{name} must be {wanted}, not {value!r}')
    low, high = about['low'], about['high']
    if low is not None and not low <= value <= high:
        raise InputError(f'{name} must lie in [{low:g}, {high:g}] {about["unit"]}'.rstrip()
                         + f', not {value:g}')
    if about['choices'] and value not in about['choices']:
        raise InputError(f'{name} must be one of {", ".join(about["choices"])}, not "{value}"')
    return kind(value)
