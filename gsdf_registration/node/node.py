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

from gsdf_registration.common.config import Config, settings
from gsdf_registration.common.formatting import length
from gsdf_registration.common.result import InputError
from gsdf_registration.field import Field
from gsdf_registration.live.worker import Live
from gsdf_registration.node.inputs import Inputs
from gsdf_registration.node.journal import NO_JOURNAL, check_path, follow, keep_journal
from gsdf_registration.node.loading import load
from gsdf_registration.node.model_reloader import ModelReloader
from gsdf_registration.node.outputs import Outputs
from gsdf_registration.node.parameters import declare_parameters, watch_parameters
from gsdf_registration.node.publishers import StatusPublisher
from gsdf_registration.node.services import Services
from gsdf_registration.node.status import with_live
from gsdf_registration.registration.acceptance import moved
from gsdf_registration.session import Session
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.status import Status

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
            self.show_soon()
    return told


class RegistrationNode(LifecycleNode):
    """
    Node ``registration``.

    All callbacks run on one executor thread; what takes long runs on others: `Services`, `Live`.

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
        self._journal = NO_JOURNAL
        self._inputs: Inputs | None = None
        self.outputs: Outputs | None = None
        self.live = Live(self)
        self._status = StatusPublisher(self)
        self._serving = Services(self)
        self._exchange = ModelReloader(self)
        self.create_timer(1.0, self._tick)
        watch_parameters(self, lambda: self.config, self._why_fixed, self._change)

    def start(self) -> None:
        """Become active if ``autostart``; a node that cannot stays, and its status says why."""
        if self._autostart and self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()
        self.show()

    def finish(self, timeout: float) -> bool:
        """End the lifecycle, go off the air; False if a solve goes on after ``timeout`` seconds."""
        self.cancelled.set()
        if not self._serving.idle(timeout) or not self._exchange.idle():
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
        self._journal.close()
        self._journal = keep_journal(self.session, config.session, self.get_logger())
        self._exchange.use(config.model)
        self._problem = None
        self.outputs = Outputs(self, config)
        self._inputs = Inputs(self, config)
        return super().on_configure(state)

    @_told
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen and, if ``collect.automatic``, collect."""
        result = super().on_activate(state)
        self.cancelled.clear()
        self.session.collect(self.config.collect.automatic or self.session.collecting)
        if self.outputs is not None:
            self.outputs.bone(self._field, self.session)
        self.live.start(self.session, self._field, self.config)
        return result

    @_told
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening; what has been collected stays."""
        self.cancelled.set()
        self.live.stop()
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
        self.live.stop()
        for each in (self._inputs, self.outputs):
            if each is not None:
                each.destroy()
        self._inputs, self.outputs, self._field = None, None, None
        self._journal.close()
        self._journal = NO_JOURNAL
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
        missing = 'configure and activate' if self.state == 'unconfigured' else 'activate'
        return f'the node is {self.state}; {missing} it first'

    def now(self) -> float:
        """Return the time of the node's clock in seconds."""
        return self.get_clock().now().nanoseconds * 1e-9

    def take_point(self, stamp: float, position: Sequence[float], frame_id: str, topic: str,
                   arrival: float | None = None) -> None:
        """Hand a tip position (3,), m, that came in at ``arrival``, s, to the session."""
        if self.session.add_point(stamp, position, frame_id, topic, arrival=arrival) is None:
            self.live.wake()

    def clear(self) -> Answer:
        """Begin a new session, as the operator asks: drop what is held and what is on its way."""
        if self._inputs is not None:
            self._inputs.forget()
        return self.session.clear()

    def start_anew(self, why: str) -> None:
        """Begin a new session without being asked, and say why."""
        words = f'a new session was begun, for {why}'
        self.session.clear()
        self.session.remark(words)
        self.live.wake()
        self.get_logger().warning(words, throttle_duration_sec=0.2)
        self.show()

    def _tick(self) -> None:
        status = self._session_status()
        self._status.tick(status, self.live.status)
        causes = {cause: count for cause, count in status.rejected.items()
                  if count and cause not in ('not_collecting', 'touched')}
        before, self._refused = self._refused, sum(causes.values())
        if self._refused > before:
            words = ', '.join(f'{count} {cause}' for cause, count in causes.items())
            self.get_logger().warning(f'points refused so far: {words}', throttle_duration_sec=10.0)

    def show(self) -> None:
        """Publish ``~/status`` if it has changed."""
        self._status.show(self._session_status(), self.live.status)

    def show_soon(self) -> None:
        """Have the executor `show`; for other threads, and in the middle of a transition."""
        if self.executor is not None:
            self.executor.create_task(self.show)

    def _session_status(self) -> Status:
        status, refusal = with_live(self.session.status(), self.live.status), self.refusal()
        reason = status.reason if self._problem is None else self._problem.reason
        told = [self._inputs.trouble if self._inputs is not None else '', status.message,
                self._exchange.notice]
        message = refusal or '; '.join(sentence for sentence in told if sentence)
        return dataclasses.replace(status, message=message, reason=reason)

    def publish_pose(self) -> None:
        """Publish the last good pose, if there is one."""
        if self.outputs is not None:
            self.outputs.registration(self.session)

    def moved_since(self, before: Status) -> str:
        """Return in words how far the registered bone is from where it was ``before``."""
        now, then = self.session.status().pose_result, before.pose_result
        assert now is not None and then is not None and self._field is not None
        assert now.T_tracker_bone is not None and then.T_tracker_bone is not None
        distance = moved(then.T_tracker_bone, now.T_tracker_bone, self._field)
        return f'the bone moved by {length(distance)} (RMS)'

    def take_bone(self, field: Field) -> bool:
        """Work with this bone from now on; tell as `Session.set_model`, which says what stays."""
        self._field = field
        other = self.session.set_model(field)
        if self.state == 'active':
            if self.outputs is not None:
                self.outputs.bone(field, self.session)
            self.live.start(self.session, field, self.config)
        return other

    def _why_fixed(self, name: str) -> str:
        if self.state == 'unconfigured' or not dict(settings())[name].metadata['fixed']:
            return ''
        return (f'{name} is read when the node is configured; call the transitions deactivate and '
                'cleanup, set it, and configure and activate again')

    def _change(self, config: Config) -> None:
        other_bone = self._exchange.wanted(config)
        check_path(config.session, self.config.session)
        if other_bone:
            config = self._exchange.until_then(config)
        self.session.configure(config)
        before, self.config = self.config, config
        self._journal = follow(self.session, self._journal, config.session, self.get_logger())
        if other_bone:
            self._exchange.begin()
        if self._inputs is not None:
            if config.probe.topics != before.probe.topics:
                self._inputs.destroy()
                self._inputs = Inputs(self, config)
            self._inputs.configure(config)
        if self.outputs is not None:
            self.outputs.configure(config)
        if config.live.enabled == before.live.enabled:
            self.live.configure(config)
        elif self.state == 'active':
            self.live.start(self.session, self._field, config)
