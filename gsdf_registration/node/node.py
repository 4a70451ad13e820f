# SPDX-License-Identifier: Apache-2.0
"""The lifecycle node: takes messages to the session, brings results back, and computes nothing."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from gsdf_registration.field import Field
from gsdf_registration.node.inputs import Inputs
from gsdf_registration.node.loading import load
from gsdf_registration.node.parameters import declare_parameters, watch_parameters
from gsdf_registration.node.publishers import PosePublishers, StatusPublisher
from gsdf_registration.node.services import Services
from gsdf_registration.result import InputError
from gsdf_registration.session import Session
from gsdf_registration.session_status import Status

Transition = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def _told(transition: Transition) -> Transition:
    """Say what a transition stumbles over; rclpy itself drops it without a word."""
    @wraps(transition)
    def told(self: RegistrationNode, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except InputError as error:
            self._problem = error
            self.get_logger().error(error.message)
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._problem = InputError(f'{transition.__name__}: {type(error).__name__}: {error}')
            self.get_logger().fatal(self._problem.message)
            raise
        finally:
            self._show_soon()
    return told


class RegistrationNode(LifecycleNode):
    """
    Node ``registration``.

    All callbacks run on one executor thread; what takes long runs on its own, see `Services`.

    Raises
    ------
    InputError
        When a parameter cannot be used.

    """

    def __init__(self) -> None:
        super().__init__('registration')
        self.config = declare_parameters(self)
        self._autostart = self.declare_parameter('autostart', True, ParameterDescriptor(
            description='become active without a lifecycle manager', read_only=True)).value
        self.session = Session(self.config)
        self._problem: InputError | None = None     # why the node could not be configured
        self.cancelled = threading.Event()
        self._refused = 0
        self._field: Field | None = None
        self._inputs: Inputs | None = None
        self._poses: PosePublishers | None = None
        self._status = StatusPublisher(self)
        self._serving = Services(self)
        self.create_timer(1.0, self._tick)
        watch_parameters(self, self._why_fixed, self._change)

    def start(self) -> None:
        """Become active if ``autostart``; a node that cannot stays, and its status says why."""
        if self._autostart and self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()
        self.show()

    def finish(self, timeout: float) -> bool:
        """End the lifecycle, go off the air; False if a solve goes on after ``timeout`` seconds."""
        self.cancelled.set()
        if not self._serving.idle(timeout):
            return False
        if self.state != 'finalized':
            self.trigger_shutdown()
        self.destroy_node()
        return True

    @_told
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the bone and open the topics."""
        config = self.config
        self.show()
        self._field = load(config, self.get_logger())
        self.session = Session(config, self._field)
        self._problem = None
        self._poses = PosePublishers(self, config)
        self._inputs = Inputs(self, config)
        return super().on_configure(state)

    @_told
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen and, if ``collect.automatic``, collect."""
        result = super().on_activate(state)
        self.cancelled.clear()
        self.session.collect(self.config.collect.automatic)
        if self._field is not None and self._poses is not None:
            self._poses.surface(self._field)
        return result

    @_told
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening; what has been collected stays."""
        self.cancelled.set()
        self.session.collect(False)
        return super().on_deactivate(state)

    @_told
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the bone and the session."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    @_told
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the bone and the session, for good."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def _release(self) -> None:
        self.cancelled.set()
        if self._inputs is not None:
            self._inputs.destroy()
        if self._poses is not None:
            self._poses.destroy()
        self._inputs, self._poses, self._field = None, None, None
        self.session = Session(self.config)

    @property
    def state(self) -> str:
        """Lifecycle state: 'unconfigured', 'inactive', 'active', ..."""
        return self._state_machine.current_state[1]

    def refusal(self) -> str:
        """Return why services cannot be given now; empty when the node is active."""
        if self.state == 'active':
            return ''
        if self.state == 'configuring':
            return 'the bone is being loaded; wait a moment'
        if self._problem is not None:
            return f'{self._problem.reason}: {self._problem.message}'
        return f'the node is {self.state}; activate it first'

    def now(self) -> float:
        """Return the time of the node's clock in seconds."""
        return self.get_clock().now().nanoseconds * 1e-9

    def take_point(self, stamp: float, position: Sequence[float], frame_id: str,
                   topic: str) -> None:
        """Hand a tip position (3,), m, to the session; the node must be active."""
        self.session.add_point(stamp, position, frame_id, topic, arrival=self.now())

    def _tick(self) -> None:
        status = self._session_status()
        self._status.tick(status)
        causes = {cause: count for cause, count in status.rejected.items()
                  if count and cause != 'not_collecting'}
        before, self._refused = self._refused, sum(causes.values())
        if self._refused > before:
            words = ', '.join(f'{count} {cause}' for cause, count in causes.items())
            self.get_logger().warning(f'points refused so far: {words}', throttle_duration_sec=10.0)

    def show(self) -> None:
        """Publish ``~/status`` if it has changed."""
        self._status.show(self._session_status())

    def _show_soon(self) -> None:
        if self.executor is not None:   # which is in the middle of a transition
            self.executor.create_task(self.show)

    def _session_status(self) -> Status:
        status, refusal = self.session.status(), self.refusal()
        reason = status.reason if self._problem is None else self._problem.reason
        return dataclasses.replace(status, message=refusal or status.message, reason=reason)

    def publish_pose(self) -> None:
        """Publish the last good pose, if there is one."""
        if self._poses is not None:
            self._poses.publish(self.session)

    def _why_fixed(self, name: str) -> str:
        if name.startswith('model.') and self.state != 'unconfigured':
            return (
                f'{name} is read when the node is configured; call the transitions deactivate and '
                'cleanup, set it, and configure and activate again')
        return ''

    def _change(self, values: dict[str, Any]) -> None:
        config = self.config.replaced(values)
        self.session.configure(config)
        self.config = config
        if self._poses is not None:
            self._poses.configure(config)
