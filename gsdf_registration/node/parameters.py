# SPDX-License-Identifier: Apache-2.0
"""The settings of `common.config` as ROS parameters: described, typed, ranged and validated."""

from __future__ import annotations

import dataclasses
import traceback
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

from gsdf_registration.common.config import PLACES, Config, UnmatchedPlaces, settings, valid_value
from gsdf_registration.common.naming import prefix_of
from gsdf_registration.common.parameter_file import (
    NODE_PARAMETERS,
    foreign_sentence,
    is_foreign,
)
from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import default_value, shortened, shown
from msg_adapters.session_file import session_path

# Topics with messages of other types that every node, or this one, publishes or receives
ROS_TOPICS = frozenset({'/clock', '/diagnostics', '/parameter_events', '/rosout', '/tf',
                        '/tf_static'})
TYPES = {bool: Parameter.Type.BOOL, int: Parameter.Type.INTEGER, float: Parameter.Type.DOUBLE,
         str: Parameter.Type.STRING}


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
             if name.split('.')[0] not in NODE_PARAMETERS}
    foreign = {name for name in given if is_foreign(name, known)}
    if foreign:     # as in a section /** of a file for several nodes
        node.get_logger().warning(foreign_sentence(foreign))
        given = {name: value for name, value in given.items() if name not in foreign}
    config = validated(node, Config(), given)
    for name, value in config.flat().items():
        kind = parameter_type(known[name])
        # the type cannot be derived from an empty list: declare the type, then set the value
        node.declare_parameter(name, kind, descriptor(known[name]), ignore_override=True)
        node.set_parameters([Parameter(name, kind, value)])
    return config


class ParameterWatch:
    """
    Applies later changes of the parameters; of each request either all or none.

    Names, positions and ``guidance.near`` may be set one after the other, as ``ros2 param load``
    does: they are pending until they match, and the current settings stay in use.

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

    def __init__(self, node: Node, current: Callable[[], Config], fixed: Callable[[str], str],
                 change: Callable[[Config], None]) -> None:
        self.waiting = ''       # sentence on what is held
        self._node = node
        self._current = current
        self._fixed = fixed
        self._change = change
        self._known = dict(settings())
        self._held: dict[str, Any] = {}
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._apply)

    def _own(self, parameters: list[Parameter]) -> dict[str, Any]:
        return {each.name: each.value for each in parameters
                if each.name in self._known or not self._node.has_parameter(each.name)}

    def _convert(self, parameters: list[Parameter]) -> list[Parameter]:
        """Convert integers and empty lists to the declared type, which rclpy checks next."""
        try:
            config, held, _ = self._merged(self._own(parameters))
            flat = config.flat() | held
        except InputError as error:
            raise _Invalid(error.message) from None
        # noqa: BLE001 - an internal error must not end the node
        except Exception as error:
            raise _Invalid(self._internal_error(error)) from None
        return [Parameter(each.name, parameter_type(self._known[each.name]), flat[each.name])
                if each.name in self._known else each for each in parameters]

    def _apply(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._change_to(self._own(parameters))
        except InputError as error:
            return SetParametersResult(successful=False, reason=error.message)
        # noqa: BLE001 - an internal error must not end the node
        except Exception as error:
            return SetParametersResult(successful=False, reason=self._internal_error(error))
        return SetParametersResult(successful=True)

    def _change_to(self, values: dict[str, Any]) -> None:
        before = self._current().flat()
        for name, value in values.items():
            reason = self._fixed(name) if value != before[name] else ''
            if reason:
                raise InputError(reason)
        config, held, waiting = self._merged(values)
        # not in a post-set callback, because this can fail; there is no other on-set callback
        self._change(config)
        self._held, self.waiting = held, waiting
        changed = [f'{name} = {shown(value)}' for name, value in values.items()
                   if value != before[name]]
        if changed:
            self._node.get_logger().debug(f'parameters set: {", ".join(changed)}')

    def _merged(self, values: dict[str, Any]) -> tuple[Config, dict[str, Any], str]:
        """Return the settings to use, the pending values, and what is missing."""
        current = self._current()
        together = {**self._held, **values}
        try:
            return validated(self._node, current, together), {}, ''
        except UnmatchedPlaces as error:
            if set(error.parameters) <= set(values):    # nothing is missing in this request
                raise
            held = {name: valid_value(name, value) for name, value in together.items()
                    if name in PLACES}
            rest = {name: value for name, value in values.items() if name not in PLACES}
            return validated(self._node, current, rest), held, error.waiting

    def _internal_error(self, error: Exception) -> str:
        self._node.get_logger().error(traceback.format_exc())
        return f'internal error, please report it: {type(error).__name__}: {error}'


def validated(node: Node, config: Config, values: Mapping[str, Any]) -> Config:
    """Return ``config`` with ``values`` changed; raise `InputError` if a node cannot use them."""
    config = config.replaced(values)
    config = config.named(prefix_of(node.get_namespace(), node.get_name()))
    session_path(config.session.path)
    used: set[str] = set()
    for topic in config.probe.topics + [topic for topic in [config.reference.topic] if topic]:
        name = _full_topic_name(node, topic)
        if name in ROS_TOPICS or name.startswith(f'{node.get_fully_qualified_name()}/'):
            raise InputError(f'"{shortened(topic)}" is a topic with messages of another type, used '
                             'by this node itself; use one like /probe/tip')
        if name in used:
            raise InputError(f'{topic} occurs twice in probe.topics and reference.topic')
        used.add(name)
    return config


def _full_topic_name(node: Node, topic: str) -> str:
    """Return a topic as the node would subscribe to it; raise `InputError` if it is not valid."""
    try:
        full = expand_topic_name(topic, node.get_name(), node.get_namespace())
        validate_full_topic_name(full)
        return str(node.resolve_topic_name(topic))
    except (NameValidationException, ValueError):
        raise InputError(f'"{shortened(topic)}" is not a valid topic name; use one like '
                         '/probe/tip') from None


def parameter_type(setting: dataclasses.Field[Any]) -> Parameter.Type:
    """Return the type of the parameter of a setting of `settings`."""
    if _is_list(setting):
        return (Parameter.Type.DOUBLE_ARRAY if setting.metadata['items'] is float else
                Parameter.Type.STRING_ARRAY)
    return TYPES[type(default_value(setting))]


def _is_list(setting: dataclasses.Field[Any] | None) -> bool:
    return setting is not None and isinstance(default_value(setting), list)


def descriptor(setting: dataclasses.Field[Any]) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows for a setting of `settings`."""
    about = setting.metadata
    constraints = [f'one of {", ".join(about["choices"])}' if about['choices'] else '',
                   'read when the node is configured' if about['fixed'] else '',
                   'three for each of the names' if setting.name == 'positions' else '']
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
