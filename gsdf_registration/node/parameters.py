# SPDX-License-Identifier: Apache-2.0
"""The settings of config.py as ROS parameters: same names, described, typed, ranged and checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from gsdf_registration.config import Config, default_of, settings
from gsdf_registration.result import InputError

# What rclpy and launch set on every node, and what only a node has; all else is in config.py.
FOREIGN = ('use_sim_time', 'start_type_description_service', 'autostart', 'qos_overrides')


def declare_parameters(node: Node) -> Config:
    """
    Declare every setting on ``node`` and return the config that its parameters make.

    Raises
    ------
    InputError
        At an unknown name, a wrong type, a value out of range, or positions not matching names.

    """
    names = {name for name, _ in settings()}
    # rclpy passes over an override that is never declared; a misspelt name must not go unnoticed
    for name in sorted(node._parameter_overrides):
        if name not in names and name.split('.')[0] not in FOREIGN:
            raise InputError(
                f'unknown parameter "{name}"; known ones are listed in config/registration.yaml')
    return Config.from_flat({name: _declared(node, name, setting) for name, setting in settings()})


def watch_parameters(node: Node, fixed: Callable[[str], str],
                     change: Callable[[dict[str, Any]], None]) -> None:
    """
    Pass on later changes, all of a request or none.

    Parameters
    ----------
    node
        Its parameters have been declared.
    fixed
        Returns why a name cannot change at this moment; empty if it can.
    change
        Receives the new values; raises `InputError`, changing nothing, if they cannot be used.

    """
    names = {name for name, _ in settings()}

    def on_set(parameters: list[Parameter]) -> SetParametersResult:
        values = {
            parameter.name: parameter.value
            for parameter in parameters if parameter.name in names
        }
        refusals = [why for why in map(fixed, values) if why]
        try:
            if refusals:
                raise InputError(refusals[0])
            # here and not after the fact, for it may refuse; no other callback can after us
            change(values)
        except InputError as error:
            return SetParametersResult(successful=False, reason=error.message)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def descriptor(setting: dataclasses.Field[Any]) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows of a setting of `settings`."""
    about = setting.metadata
    described = ParameterDescriptor(
        description=about['description'] + (f' [{about["unit"]}]' if about['unit'] else ''),
        additional_constraints=f'one of {", ".join(about["choices"])}' if about['choices'] else '',
        read_only=about['fixed'])
    if about['low'] is not None:
        low, high = about['low'], about['high']
        if isinstance(default_of(setting), float):
            described.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(high))
            ]
        else:
            described.integer_range = [
                IntegerRange(from_value=int(low), to_value=int(high), step=1)
            ]
    return described


def _declared(node: Node, name: str, setting: dataclasses.Field[Any]) -> Any:
    """Declare one setting; return its value, the default or what the user gave."""
    default = default_of(setting)
    kind: Any = default
    if default == []:   # an empty list does not show its type
        kind = Parameter.Type.DOUBLE_ARRAY if name.endswith(
            'positions') else Parameter.Type.STRING_ARRAY
    try:
        value = node.declare_parameter(name, kind, descriptor(setting)).value
    except ParameterException as error:
        hint = '; a number with a fraction is written 20.0, not 20' if isinstance(default,
                                                                                  float) else ''
        raise InputError(f'{error}{hint}') from error
    if value is None:   # nothing given, or [], which has no type in a parameter file
        node.set_parameters([Parameter(name, kind, [])])
        return []
    return value
