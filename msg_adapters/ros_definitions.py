# SPDX-License-Identifier: Apache-2.0
"""Find a message class by the name of its type, and write its definition for a recording."""

from __future__ import annotations

import importlib
import re
from typing import Any

from gsdf_registration.common.result import InputError

# names of IDL and of .msg files
PRIMITIVES = {'double': 'float64', 'float': 'float32', 'boolean': 'bool', 'octet': 'byte'}
SEPARATOR = '=' * 80


def message_class(msgtype: str) -> Any:
    """
    Return the class of a type such as std_msgs/msg/String, or std_srvs/srv/Trigger_Event.

    Raises
    ------
    InputError
        If its package is not installed.

    """
    package, folder, name = msgtype.split('/')
    service, _, part = name.rpartition('_')
    try:
        module = importlib.import_module(f'{package}.{folder}')
        if part in ('Event', 'Request', 'Response') and folder == 'srv':
            return getattr(getattr(module, service), part)
        return getattr(module, name)
    except (ImportError, AttributeError):
        raise InputError(f'{msgtype} is not installed, so its messages cannot be received; '
                         f'install or build {package}') from None


def definition_of(msgtype: str) -> str:
    """Return the text of the definition of a type and of all types in it, as rosbag2 stores it."""
    parts: dict[str, str] = {}
    _add(msgtype, parts)
    first, *others = parts.items()
    return f'\n{SEPARATOR}\n'.join([first[1], *(
        f'MSG: {name.replace("/msg/", "/")}\n{text}' for name, text in others)])


def _add(msgtype: str, parts: dict[str, str]) -> None:
    """Add the fields of a type and of the types in it."""
    if msgtype in parts:
        return
    parts[msgtype], nested, lines = '', [], []
    for name, kind in message_class(msgtype).get_fields_and_field_types().items():
        inner, suffix = _element(kind)
        if '/' in inner:
            package, inner_name = inner.split('/')
            folder = 'srv' if inner_name.endswith(('_Request', '_Response')) else 'msg'
            nested.append(f'{package}/{folder}/{inner_name}')
        lines.append(f'{PRIMITIVES.get(inner, inner)}{suffix} {name}\n')
    parts[msgtype] = ''.join(lines)
    for each in nested:
        _add(each, parts)


def _element(kind: str) -> tuple[str, str]:
    """Return the type of an element of a field, and what follows it in a .msg file."""
    sequence = re.fullmatch(r'sequence<([^,>]+(?:<\d+>)?)(?:, (\d+))?>', kind)
    if sequence:
        return _bounded(sequence[1]), f'[<={sequence[2]}]' if sequence[2] else '[]'
    array = re.fullmatch(r'(.+)\[(\d+)\]', kind)
    if array:
        return _bounded(array[1]), f'[{array[2]}]'
    return _bounded(kind), ''


def _bounded(kind: str) -> str:
    """Return a string type with the length that it may have as in a .msg file."""
    return re.sub(r'^(w?string)<(\d+)>$', r'\1<=\2', kind)
