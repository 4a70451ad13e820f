# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files: which sections and which names belong to a registration node."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import flatten, shortened

# Parameters of rclpy, launch and the node that are no setting
NODE_PARAMETERS = ('use_sim_time', 'start_type_description_service', 'autostart', 'qos_overrides',
                   'service_configure_introspection')
NODE_NAME = 'registration'
WILDCARDS = ('', '*', '**')
SIMILAR = 0.8       # ratio of difflib above which an unknown name is a misspelt one


def parameters_of_file(values: Mapping[str, Any], known: Collection[str]) -> dict[str, Any] | None:
    """
    Return the dotted parameters that a file has for a registration node.

    With one section, its node may have any name. With several, wildcards such as ``/**`` apply
    first, then the section of the node named registration, in any namespace.

    Parameters
    ----------
    values : nested mappings of the file
    known : dotted names of all settings

    Returns
    -------
    dict or None
        None if the file has no ``ros__parameters``.

    Raises
    ------
    InputError
        If the file has sections for several nodes of this package, or for other nodes only.

    """
    sections = dict(_sections(values, ''))
    if not sections:
        return None
    wild = [node for node in sections if node.split('/')[-1] in WILDCARDS]
    named = [node for node in sections if node not in wild]
    if len(sections) > 1:
        named = ([node for node in named if node.split('/')[-1] == NODE_NAME]
                 or [node for node in named if any(name in known for name in sections[node])])
    if len(named) > 1:
        raise InputError(f'there are sections for {" and ".join(named)}; give a file with the '
                         'section of one node')
    if not named and not wild:
        raise InputError(f'there are sections for {", ".join(sections)}, but none for a node '
                         f'named {NODE_NAME}')
    merged: dict[str, Any] = {}
    for node in wild + named:
        merged |= sections[node]
    return {name: value for name, value in merged.items()
            if name.split('.')[0] not in NODE_PARAMETERS}


def _sections(values: Mapping[str, Any], node: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of each node, with its namespace, and its dotted parameters."""
    for key, inner in values.items():
        if key == 'ros__parameters' and isinstance(inner, Mapping):
            yield node, dict(flatten(inner))
        elif isinstance(inner, Mapping):
            yield from _sections(inner, f'{node.rstrip("/")}/{str(key).strip("/")}')


def is_foreign(name: str, known: Collection[str]) -> bool:
    """
    Return whether an unknown parameter belongs to another node of the same parameter file.

    A name in one of the sections of ``known``, or one similar to a known name, is a misspelt one.
    """
    if name in known or name.split('.')[0] in {each.split('.')[0] for each in known}:
        return False
    return not difflib.get_close_matches(name[:100], known, 1, SIMILAR)


def foreign_sentence(names: Collection[str]) -> str:
    """Return the warning about foreign parameters."""
    shown = ', '.join(shortened(name) for name in sorted(names)[:10])
    more = f' and {len(names) - 10} more' if len(names) > 10 else ''
    return f'ignored parameters that this program does not have: {shown}{more}'
