# SPDX-License-Identifier: Apache-2.0
"""The settings of `common.config` as ROS parameters: described, typed, ranged and validated."""

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
from gsdf_registration.common.settings_schema import default_value
from gsdf_registration.node.naming import prefix_of

# Parameters of rclpy and launch, and those of the node that are no setting of `Config`
FOREIGN = ('use_sim_time', 'start_type_description_service', 'autostart', 'qos_overrides')
TYPES = {bool: Parameter.Type.BOOL, int: Parameter.Type.INTEGER, float: Parameter.Type.DOUBLE,
         str: Parameter.Type.STRING}
PAIRS = ('landmarks', 'targets')    # sections whose names and positions change together


class _Invalid(ParameterNotDeclaredException):
    """An invalid value; the parameter services return the message of this exception only."""

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)


def declare_parameters(node: Node) -> Config:
    """
    Declare every setting on ``node`` and return the resulting config.

    Raises
    ------
    InputError
        If a name is unknown, a type wrong, a value out of range or a topic name invalid, or if
        positions do not match their names.

    """
    known = dict(settings())
    # An empty list in a parameter file has no type and arrives as None. rclpy has no public access
    # to such overrides: automatically_declare_parameters_from_overrides raises an error at them.
    given = {name: [] if each.value is None and _is_list(known.get(name)) else each.value
             for name, each in node._parameter_overrides.items()
             if name.split('.')[0] not in FOREIGN}
    config = validated(node, Config(), given)
    for name, value in config.flat().items():
        kind = parameter_type(known[name])
        # the type cannot be derived from an empty list: declare the type, then set the value
        node.declare_parameter(name, kind, descriptor(known[name]), ignore_override=True)
        node.set_parameters([Parameter(name, kind, value)])
    return config


def watch_parameters(node: Node, current: Callable[[], Config], fixed: Callable[[str], str],
                     change: Callable[[Config], None]) -> None:
    """
    Apply later changes; of each request either all or none.

    Parameters
    ----------
    node
        Has declared the parameters.
    current
        Returns the settings in use.
    fixed
        Returns why a parameter cannot change now; empty if it can.
    change
        Applies the new settings; raises `InputError`, changing nothing, if they cannot be used.

    """
    known = dict(settings())

    def own(parameters: list[Parameter]) -> dict[str, Any]:
        return {each.name: each.value for each in parameters
                if each.name in known or not node.has_parameter(each.name)}

    def convert(parameters: list[Parameter]) -> list[Parameter]:
        """Convert integers and empty lists to the declared type, which rclpy checks next."""
        try:
            flat = validated(node, current(), own(parameters)).flat()
        except InputError as error:
            raise _Invalid(error.message) from None
        return [Parameter(each.name, parameter_type(known[each.name]), flat[each.name])
                if each.name in known else each for each in parameters]

    def apply(parameters: list[Parameter]) -> SetParametersResult:
        before, values = current().flat(), own(parameters)
        try:
            for name, value in values.items():
                reason = fixed(name) if value != before[name] else ''
                if reason:
                    raise InputError(reason)
            # not in a post-set callback, because this can fail; there is no other on-set callback
            change(current().replaced(values))
        except InputError as error:
            return SetParametersResult(successful=False, reason=error.message)
        return SetParametersResult(successful=True)

    node.add_pre_set_parameters_callback(convert)
    node.add_on_set_parameters_callback(apply)


def validated(node: Node, config: Config, values: Mapping[str, Any]) -> Config:
    """Return ``config`` with ``values`` changed; raise `InputError` if a node cannot use them."""
    try:
        config = config.replaced(values)
    except InputError as error:
        raise InputError(error.message + _pairing_hint(values)) from None
    config = config.named(prefix_of(node.get_namespace(), node.get_name()))
    topics = config.probe.topics + [topic for topic in [config.reference.topic] if topic]
    for topic in topics:
        try:
            validate_full_topic_name(
                expand_topic_name(topic, node.get_name(), node.get_namespace()))
        except (NameValidationException, ValueError):
            raise InputError(
                f'"{topic}" is not a valid topic name; use one like /probe/tip') from None
        if topics.count(topic) > 1:
            raise InputError(f'{topic} occurs twice in probe.topics and reference.topic')
    return config


def _pairing_hint(values: Mapping[str, Any]) -> str:
    """Return what to do if names were set without their positions, or positions without names."""
    for section in PAIRS:
        if (f'{section}.names' in values) != (f'{section}.positions' in values):
            return (f'; set {section}.names and {section}.positions in one request, with '
                    'the service ~/set_parameters_atomically')
    return ''


def parameter_type(setting: dataclasses.Field[Any]) -> Parameter.Type:
    """Return the type of the parameter of a setting of `settings`."""
    if _is_list(setting):
        return (Parameter.Type.DOUBLE_ARRAY if setting.name == 'positions' else
                Parameter.Type.STRING_ARRAY)
    return TYPES[type(default_value(setting))]


def _is_list(setting: dataclasses.Field[Any] | None) -> bool:
    return setting is not None and isinstance(default_value(setting), list)


def descriptor(setting: dataclasses.Field[Any]) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows for a setting of `settings`."""
    about = setting.metadata
    constraints = [f'one of {", ".join(about["choices"])}' if about['choices'] else '',
                   'read when the node is configured' if about['fixed'] else '',
                   'set together with names' if setting.name == 'positions' else '']
    described = ParameterDescriptor(
        description=about['description'] + (f' [{about["unit"]}]' if about['unit'] else ''),
        additional_constraints='; '.join(each for each in constraints if each))
    if about['low'] is not None:
        low, high = about['low'], about['high']
        if isinstance(default_value(setting), float):
            described.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(high))
            ]
        else:
            described.integer_range = [
                IntegerRange(from_value=int(low), to_value=int(high), step=1)
            ]
    return described
