# SPDX-License-Identifier: Apache-2.0
"""
Lifecycle transitions of a node that prepares its configuration outside the executor.

rclpy runs a transition in one call on the executor thread. While a bone is loaded, no service would
be answered. So the transition configure awaits the preparation, and the node serves meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from gsdf_registration.common.result import InputError

RCLError = _rclpy.RCLError
SUCCESS = TransitionCallbackReturn.SUCCESS
NodeType = TypeVar('NodeType', bound='PreparedLifecycleNode')
TransitionCallback = Callable[[NodeType, LifecycleState], TransitionCallbackReturn]


def transition(during: str, after: str) -> Callable[[TransitionCallback[NodeType]],
                                                    TransitionCallback[NodeType]]:
    """
    Set the state of the node and report failures around a transition callback.

    rclpy neither exposes the lifecycle state nor logs an exception in a callback.
    """
    def decorate(callback: TransitionCallback[NodeType]) -> TransitionCallback[NodeType]:
        @wraps(callback)
        def run(self: NodeType, previous: LifecycleState) -> TransitionCallbackReturn:
            self.state, result = during, TransitionCallbackReturn.FAILURE
            try:
                result = callback(self, previous)
            except InputError as error:
                self.problem = error
                self.get_logger().error(error.message)
            except Exception as error:
                self.problem = InputError(f'{callback.__name__}: {type(error).__name__}: {error}')
                self.get_logger().fatal(self.problem.message)
                raise       # to on_error
            finally:
                self.state = after if result == SUCCESS else previous.label
                self.get_logger().debug(f'{during}: {result.name.lower()}; the node is now '
                                        f'{self.state}')
                self.publish_status_soon()
            return result
        return run
    return decorate


class PreparedLifecycleNode(LifecycleNode):
    """
    A lifecycle node that awaits `prepare` while it is configuring.

    Attributes
    ----------
    state : lifecycle state: 'inactive', 'active', 'configuring'...
    problem : why the last transition failed

    """

    def __init__(self, name: str) -> None:
        self.state = 'unconfigured'
        self.problem: InputError | None = None
        super().__init__(name)
        self._prepared: Any = None
        service: Any = self._service_change_state
        self._change_state_now = service.callback
        # rclpy has no other way to await in a transition; the group of the other services would
        # wait for this one
        service.callback = self._on_change_state
        service.callback_group = ReentrantCallbackGroup()
        service.callback_group.add_entity(service)

    async def prepare(self) -> Any:
        """Return what `on_configure` finds in ``self.prepared()``; override it."""

    def publish_status_soon(self) -> None:
        """Publish the status from the executor; override it."""

    def prepared(self) -> Any:
        """Return what `prepare` returned, or raise what it raised."""
        prepared, self._prepared = self._prepared, None
        if isinstance(prepared, Exception):
            raise prepared
        return prepared

    async def change_state(self, transition_id: int) -> bool:
        """Trigger a transition; return whether it succeeded. Other callbacks run meanwhile."""
        request = ChangeState.Request()
        request.transition.id = transition_id
        return bool((await self._on_change_state(request, ChangeState.Response())).success)

    async def _on_change_state(self, request: ChangeState.Request,
                               response: ChangeState.Response) -> ChangeState.Response:
        response.success = False
        wanted = request.transition
        try:
            number = wanted.id if not wanted.label else (
                self._state_machine.get_transition_by_label(wanted.label))
            if number == Transition.TRANSITION_CONFIGURE:
                response.success = await self._configure_when_prepared()
            else:
                response = self._change_state_now(request, response)
        except RCLError:     # would end a bare rclpy node
            self.get_logger().error(f'transition {wanted.label or wanted.id} is not possible: the '
                                    f'node is {self.state}')
        return response

    async def _configure_when_prepared(self) -> bool:
        """Do what ``trigger_configure`` of rclpy does, with a pause for `prepare`."""
        machine = self._state_machine
        number, label = machine.current_state
        previous = LifecycleState(label, number)
        machine.trigger_transition_by_id(Transition.TRANSITION_CONFIGURE, True)
        self.state = 'configuring'
        self.publish_status_soon()
        try:
            self._prepared = await self.prepare()
        # noqa: BLE001 - on_configure reports it
        except Exception as error:
            self._prepared = error
        result = self._run(self.on_configure, previous)
        machine.trigger_transition_by_label(result.to_label(), True)
        if result == TransitionCallbackReturn.ERROR:
            machine.trigger_transition_by_label(self._run(self.on_error, previous).to_label(), True)
        return bool(result == SUCCESS)

    def _run(self, callback: Callable[[LifecycleState], TransitionCallbackReturn],
             previous: LifecycleState) -> TransitionCallbackReturn:
        try:
            return callback(previous)
        # noqa: BLE001 - as in rclpy; `transition` has logged it
        except Exception:
            return TransitionCallbackReturn.ERROR
