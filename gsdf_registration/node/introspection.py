# SPDX-License-Identifier: Apache-2.0
"""
Service introspection: the node publishes requests and responses on ``<service>/_service_event``.

The parameter and its values are those of the demo nodes of ROS 2. A recording with the contents can
be replayed with what the operator did, see `msg_adapters.service_events`.
"""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState

from gsdf_registration.common.result import InputError

PARAMETER = 'service_configure_introspection'
STATES = {'disabled': ServiceIntrospectionState.OFF,
          'metadata': ServiceIntrospectionState.METADATA,
          'contents': ServiceIntrospectionState.CONTENTS}
QOS = QoSProfile(depth=1000)
# rclpy cannot introspect the services that it creates without a type support, as change_state
PACKAGES = ('std_srvs', 'gsdf_registration_msgs')
SETTERS = ('SetParameters', 'SetParametersAtomically')


class Introspection:
    """
    Declares the parameter on a node and applies it.

    Parameters
    ----------
    node : Node
        Has created its services.

    Raises
    ------
    InputError
        If the value is not one of `STATES`.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        state = node.declare_parameter(PARAMETER, 'disabled', ParameterDescriptor(
            description='whether requests and responses are published on _service_event',
            additional_constraints=f'one of {", ".join(STATES)}', dynamic_typing=True)).value
        if state not in list(STATES):
            raise InputError(_refusal(state))
        if state != 'disabled':
            self._apply(state)

    def watch(self) -> None:
        """Apply later changes; call it last: rclpy asks the callback added last first."""
        self._node.add_on_set_parameters_callback(_check)
        self._node.add_post_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == PARAMETER:
                self._apply(parameter.value)

    def _apply(self, state: str) -> None:
        for service in self._node.services:
            kind: Any = service.srv_type
            if kind.__module__.partition('.')[0] in PACKAGES or kind.__name__ in SETTERS:
                service.configure_introspection(self._node.get_clock(), QOS, STATES[state])


def _check(parameters: list[Parameter]) -> SetParametersResult:
    """Reject a value that is not one of `STATES`."""
    wrong = [each.value for each in parameters
             if each.name == PARAMETER and each.value not in list(STATES)]
    return SetParametersResult(successful=not wrong, reason=_refusal(wrong[0]) if wrong else '')


def _refusal(value: object) -> str:
    return f'{PARAMETER} must be one of {", ".join(STATES)}, not "{value}"'
