# SPDX-License-Identifier: Apache-2.0
"""The settings of config.py as ROS parameters: same names, described, typed, ranged and checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import NameValidationException, ParameterNotDeclaredException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.validate_full_topic_name import validate_full_topic_name

from gsdf_registration.common.config import Config, settings
from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import default_of

# What rclpy and launch set on every node, and what only a node has; all else is in config.py.
FOREIGN = ('use_sim_time', 'start_type_description_service', 'autostart', 'qos_overrides')
TYPES = {bool: Parameter.Type.BOOL, int: Parameter.Type.INTEGER, float: Parameter.Type.DOUBLE,
         str: Parameter.Type.STRING}
PAIRS = ('landmarks', 'targets')    # sections whose names and positions only change together


class _Unusable(ParameterNotDeclaredException):
    """What cannot be set; of all exceptions the parameter services pass on the words of this."""

    def __init__(self, sentence: str) -> None:
        Exception.__init__(self, sentence)


def declare_parameters(node: Node) -> Config:
    """
    Declare every setting on ``node`` and return the config that its parameters make.

    Raises
    ------
    InputError
        At an unknown name, a wrong type, a value out of range, positions not matching names, or
        what is no name of a topic.

    """
    known = dict(settings())
    # [] has no type in a parameter file, and arrives as nothing
    given = {name: [] if each.value is None and _is_list(known.get(name)) else each.value
             for name, each in node._parameter_overrides.items()
             if name.split('.')[0] not in FOREIGN}
    config = usable(node, Config(), given)
    for name, value in config.flat().items():
        kind = parameter_type(known[name])
        # an empty list does not show its type, so the type is declared and the value set
        node.declare_parameter(name, kind, descriptor(known[name]), ignore_override=True)
        node.set_parameters([Parameter(name, kind, value)])
    return config


def watch_parameters(node: Node, current: Callable[[], Config], fixed: Callable[[str], str],
                     change: Callable[[Config], None]) -> None:
    """
    Pass on later changes, all of a request or none.

    Parameters
    ----------
    node
        Its parameters have been declared.
    current
        Returns the settings in force.
    fixed
        Returns why a name cannot change at this moment; empty if it can.
    change
        Receives the new settings; raises `InputError`, changing nothing, if they cannot be used.

    """
    known = dict(settings())

    def ours(parameters: list[Parameter]) -> dict[str, Any]:
        return {each.name: each.value for each in parameters
                if each.name in known or not node.has_parameter(each.name)}

    def in_type(parameters: list[Parameter]) -> list[Parameter]:
        """Give whole numbers and empty lists the type declared, before rclpy looks at it."""
        try:
            flat = usable(node, current(), ours(parameters)).flat()
        except InputError as error:
            raise _Unusable(error.message) from None
        return [Parameter(each.name, parameter_type(known[each.name]), flat[each.name])
                if each.name in known else each for each in parameters]

    def on_set(parameters: list[Parameter]) -> SetParametersResult:
        before, values = current().flat(), ours(parameters)
        try:
            for name, value in values.items():
                why = fixed(name) if value != before[name] else ''
                if why:
                    raise InputError(why)
            # here and not after the fact, for it may refuse; no other callback can after us
            change(current().replaced(values))
        except InputError as error:
            return SetParametersResult(successful=False, reason=error.message)
        return SetParametersResult(successful=True)

    node.add_pre_set_parameters_callback(in_type)
    node.add_on_set_parameters_callback(on_set)


def usable(node: Node, config: Config, values: Mapping[str, Any]) -> Config:
    """Return ``config`` with ``values`` changed; `InputError` if a node cannot work by them."""
    try:
        config = config.replaced(values)
    except InputError as error:
        raise InputError(error.message + _how_to_pair(values)) from None
    if not config.session.path:
        raise InputError('session.path is empty; name the file of ~/save and ~/load')
    topics = config.probe.topics + [topic for topic in [config.reference.topic] if topic]
    for topic in topics:
        try:
            validate_full_topic_name(
                expand_topic_name(topic, node.get_name(), node.get_namespace()))
        except (NameValidationException, ValueError):
            raise InputError(f'"{topic}" is no name of a topic; give one like /probe/tip') from None
        if topics.count(topic) > 1:
            raise InputError(f'{topic} is named twice in probe.topics and reference.topic')
    return config


def _how_to_pair(values: Mapping[str, Any]) -> str:
    """Return what to do when names are set without their positions, or the other way round."""
    for section in PAIRS:
        if (f'{section}.names' in values) != (f'{section}.positions' in values):
            return (f'; set {section}.names and {section}.positions in one request, by the '
                    'service ~/set_parameters_atomically')
    return ''


def parameter_type(setting: dataclasses.Field[Any]) -> Parameter.Type:
    """Return the type of the parameter of a setting of `settings`."""
    if _is_list(setting):
        return (Parameter.Type.DOUBLE_ARRAY if setting.name == 'positions' else
                Parameter.Type.STRING_ARRAY)
    return TYPES[type(default_of(setting))]


def _is_list(setting: dataclasses.Field[Any] | None) -> bool:
    return setting is not None and isinstance(default_of(setting), list)


def descriptor(setting: dataclasses.Field[Any]) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows of a setting of `settings`."""
    about = setting.metadata
    constraints = [f'one of {", ".join(about["choices"])}' if about['choices'] else '',
                   'read when the node is configured' if about['fixed'] else '',
                   'set together with names' if setting.name == 'positions' else '']
    described = ParameterDescriptor(
        description=about['description'] + (f' [{about["unit"]}]' if about['unit'] else ''),
        additional_constraints='; '.join(words for words in constraints if words))
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
