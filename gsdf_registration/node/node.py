# SPDX-License-Identifier: Apache-2.0
"""The lifecycle node: connects topics, services and parameters with a session."""

from __future__ import annotations

import dataclasses
import threading
from typing import Any

from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from gsdf_registration.common.config import Config, settings
from gsdf_registration.common.result import InputError
from gsdf_registration.common.samples import Rejection
from gsdf_registration.field import Field
from gsdf_registration.live import LiveStatus
from gsdf_registration.live.worker import LiveWorker
from gsdf_registration.node.events import EventPublisher, Place
from gsdf_registration.node.hints import Hint, Hints
from gsdf_registration.node.initial_pose import InitialPoseInput
from gsdf_registration.node.inputs import Inputs
from gsdf_registration.node.introspection import Introspection
from gsdf_registration.node.lifecycle import PreparedLifecycleNode, RCLError, transition
from gsdf_registration.node.loading import load
from gsdf_registration.node.model_reloader import ModelReloader
from gsdf_registration.node.outputs import Outputs
from gsdf_registration.node.parameters import ParameterWatch, declare_parameters
from gsdf_registration.node.progress import Progress
from gsdf_registration.node.publishers import StatusPublisher
from gsdf_registration.node.qos import OFFERED, STEADY
from gsdf_registration.node.services import Services
from gsdf_registration.node.session_files import SessionFiles
from gsdf_registration.node.sim_clock import SimClock
from gsdf_registration.node.tip import TipPublisher, create_tip_publisher
from gsdf_registration.session import Session
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.session import restart_notice
from gsdf_registration.session.status import Status
from gsdf_registration.session.status_values import combined_status, not_active, sentence


class RegistrationNode(PreparedLifecycleNode):
    """
    Node ``registration``.

    All callbacks run on one executor thread; long computations run on the threads of `Services`,
    `ModelReloader` and `LiveWorker`.

    Raises
    ------
    InputError
        If a parameter cannot be used.

    """

    def __init__(self) -> None:
        super().__init__('registration')
        self._sim_clock = SimClock(self)
        config = declare_parameters(self)
        self._autostart = self.declare_parameter('autostart', True, ParameterDescriptor(
            description='become active without a lifecycle manager', read_only=True)).value
        self.session = Session(config)
        self.field: Field | None = None
        self.cancelled = threading.Event()
        self.progress = Progress(self.publish_status_soon)
        self._rejected = 0                          # points, at the last tick
        self.files = SessionFiles(self.get_logger())
        self._inputs: Inputs | None = None
        self._outputs: Outputs | None = None
        self._live: LiveWorker | None = None
        self._status = StatusPublisher(self)
        self._tip = create_tip_publisher(self)
        self.events = EventPublisher(self)
        self._private_services = Services(self)
        introspection = Introspection(self)
        self._initial_pose = InitialPoseInput(self)
        self._reloader = ModelReloader(self)
        self._hints = Hints(self, self.get_logger(), OFFERED)
        self.create_timer(1.0, self._tick, clock=STEADY)
        self._parameter_watch = ParameterWatch(self, lambda: self.session.config,
                                               self._why_fixed, self._configure)
        introspection.watch()

    async def start(self) -> None:
        """Become active if ``autostart``; after a failure ``~/status`` says why."""
        if self._autostart and await self.change_state(Transition.TRANSITION_CONFIGURE):
            assert self.executor is not None    # it runs this task
            # a task of its own: other callbacks run in between
            self.executor.create_task(self.change_state, Transition.TRANSITION_ACTIVATE)
        self.publish_status()

    def finish(self, timeout: float) -> bool:
        """Shut down and destroy the node; False if a job still runs after ``timeout`` seconds."""
        self.cancelled.set()
        if not self._private_services.shutdown(timeout) or not self._reloader.shutdown():
            return False
        if self.state != 'finalized':
            self.trigger_shutdown()
        self.destroy_node()
        return True

    async def prepare(self) -> tuple[Field | None, Session]:
        """Load the bone and start a session, in the background."""
        config = self.session.config

        def job() -> tuple[Field | None, Session]:
            field = load(config, self.get_logger(), self.progress.show)
            session = Session(config, field)
            self.files.open(session, config.session)
            return field, session
        try:
            return await self._reloader.run(job)
        finally:
            self.progress.end()

    @transition('configuring', 'inactive')
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create subscriptions and publishers for the bone and session that are prepared."""
        self.field, session = self.prepared()
        config, changed = session.config, self.session.config
        self.session = session
        self.session.listen(self._on_session_event)
        self._reloader.set_current(config.model)
        self.problem = None
        self._outputs = Outputs(self, config)
        self._inputs = Inputs(self, config, TipPublisher(self._tip, self.session),
                              self.events.last)
        self._report_state('configure')
        if not changed.probe.tip:   # the session that is resumed may have one
            changed = changed.replaced({'probe.tip': config.probe.tip})
        if changed != config:   # by a parameter set meanwhile
            self._configure(changed)
        self.adopt_tip()
        return super().on_configure(state)

    @transition('activating', 'active')
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Receive points and, if ``collect.automatic``, collect them."""
        result = super().on_activate(state)
        self.cancelled.clear()
        self._report_state('activate')
        self.session.activate()
        if self._inputs is not None:
            self._inputs.activate()
        if self._outputs is not None:
            self._outputs.show_bone(self.field, self.session)
        self._start_live()
        return result

    @transition('deactivating', 'inactive')
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop receiving points; the collected points stay."""
        self.cancelled.set()
        self._report_state('deactivate')
        if self._inputs is not None:
            self._inputs.active = False
        self._stop_live()
        self.session.deactivate()
        self._renew_hints()
        if self._outputs is not None:
            self._outputs.withdraw(self.session)
        return super().on_deactivate(state)

    @transition('cleaningup', 'unconfigured')
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Unload the bone and end the session."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    @transition('shuttingdown', 'finalized')
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Unload the bone and end the session."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def _report_state(self, name: str, place: Place | None = None) -> None:
        """Publish a change of the node's state with all settings, at this place or here."""
        self.events.publish(name, place or self.events.begin(self.session.kept), request={
            'settings': self.session.config.flat(),
            'model_sha256': None if self.field is None else self.field.bone_sha256})

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After an exception in a transition, become unconfigured."""
        result = super().on_error(state)
        success = result == TransitionCallbackReturn.SUCCESS
        self.state = 'unconfigured' if success else 'finalized'
        return result

    def _release(self) -> None:
        self.cancelled.set()
        self._stop_live()
        if self._outputs is not None:
            self._outputs.withdraw(self.session)
        for each in (self._inputs, self._outputs):
            if each is not None:
                each.destroy()
        self._inputs, self._outputs, self.field = None, None, None
        self.files.close()
        self.session = Session(self.session.config)
        self._renew_hints()

    def refusal(self) -> str:
        """Return why requests are refused now; empty while the node is active."""
        if self.state == 'active':
            return ''
        if self.state == 'configuring':
            return self.progress.sentence or 'the bone is being loaded; wait a moment'
        if self.state == 'finalized':
            return 'the node is finalized; start a new one'
        if self.problem is not None:
            return f'{self.problem.reason}: {self.problem.message}'
        missing = 'configure and activate' if self.state == 'unconfigured' else 'activate'
        return f'the node is {self.state}; {missing} it first'

    def now(self) -> float:
        """Return the time of the node's clock, s."""
        return self.get_clock().now().nanoseconds * 1e-9

    def clear(self) -> Answer:
        """Start a new session; drop collected points and those that wait for a transform."""
        if self._inputs is not None:
            self._inputs.clear()
        return self.session.clear()

    def set_tip(self, tip: list[float], error: float | None) -> None:
        """Set ``probe.tip``, (3,) m, and ``probe.tip_error``, m; `InputError` if that fails."""
        changes = [Parameter('probe.tip', Parameter.Type.DOUBLE_ARRAY, tip)]
        if error is not None:
            changes.append(Parameter('probe.tip_error', Parameter.Type.DOUBLE, error))
        for change, result in zip(changes, self.set_parameters(changes)):
            if not result.successful:
                raise InputError(f'{change.name} is not set: {result.reason}')

    def adopt_tip(self) -> None:
        """Set tip and error to those of a session that was loaded, see `SessionState.restore`."""
        probe = self.session.config.probe
        if probe.tip != list(self.get_parameter('probe.tip').value):
            self.set_tip(probe.tip, probe.tip_error)
            self.get_logger().info('probe.tip was not set; that of the session is used')

    def publish_status(self) -> None:
        """Publish ``~/status``, and the registration or its withdrawal, if they have changed."""
        self.publish_registration()
        self._status.publish_status(self._current_status(), self._live_status)

    def publish_registration(self) -> None:
        """Publish the accepted registration, or its withdrawal, if either has changed."""
        if self._outputs is not None and self.state == 'active':
            self._outputs.show_registration(self.session)

    def registration_finished(self, success: bool) -> None:
        """Report the end of a registration to the live registration."""
        if self._live is not None:
            self._live.registration_finished(success)

    def use_model(self, field: Field) -> bool:
        """Use this bone; return whether it replaces a different one, see `Session.set_model`."""
        self.field = field
        place = self.events.begin(self.session.kept)
        other = self.session.set_model(field)
        self._report_state('model', place)
        if self.state == 'active':
            if self._outputs is not None:
                self._outputs.show_bone(field, self.session)
            self._start_live()
        return other

    def _start_live(self) -> None:
        """Start or restart the live registration, if it is enabled and there is a bone."""
        self._stop_live()
        session, outputs = self.session, self._outputs
        if session.config.live.enabled and self.field is not None and outputs is not None:
            self._live = LiveWorker(
                session, self.field, on_pose=outputs.show_live_pose,
                on_assessment=lambda found: outputs.show_assessment(found, session),
                on_status_change=self.publish_status_soon, on_error=self._on_live_error)

    def _stop_live(self) -> None:
        if self._live is not None:
            self._live.stop()
        self._live = None

    @property
    def _live_status(self) -> LiveStatus:
        return LiveStatus() if self._live is None else self._live.status

    def _on_live_error(self, message: str) -> None:
        self.get_logger().error(message, throttle_duration_sec=10.0)

    def _on_session_event(self, event: str, value: Any) -> None:
        """React to a change of the session; called with the session locked, from any thread."""
        if event == 'rejected':
            return
        if event == 'clear' and value:
            self.get_logger().warning(restart_notice(value), throttle_duration_sec=0.2)
        if self._live is not None:
            self._live.notify()
        if event not in ('point', 'rejected'):      # the status counts samples once a second only
            self.publish_status_soon()

    def publish_status_soon(self) -> None:
        """Publish the status from the executor; for other threads and inside a transition."""
        if self.executor is not None:
            self.executor.create_task(self.publish_status)

    def _current_status(self) -> Status:
        """Return the status of session, live registration and node combined."""
        status, refusal = combined_status(self.session.status(), self._live_status), self.refusal()
        if self.state != 'active':
            status = not_active(status)
        problem = '' if self._inputs is None else self._inputs.problem
        return dataclasses.replace(
            status,
            message=sentence(
                refusal or sentence(problem, status.message, self.files.problem,
                                    self._parameter_watch.waiting, self._reloader.notice),
                self._hints.sentence),
            warning=status.warning or bool(self.files.problem) or self._hints.warning,
            reason=status.reason if self.problem is None else self.problem.reason,
            progress=self.progress.share)

    def _tick(self) -> None:
        if self.state in ('active', 'inactive'):
            self.files.check()
        lost = 0 if self._inputs is None else self._inputs.take_lost()
        if lost:
            self.session.count_rejected({Rejection.LOST.value: lost})
        self._renew_hints()
        status = self._current_status()
        self._status.publish_diagnostics(status, self._live_status)
        causes = {cause: count for cause, count in status.rejected.items()
                  if count and cause not in ('not_collecting', 'touched', 'calibrating', 'undone')}
        before, self._rejected = self._rejected, sum(causes.values())
        if self._rejected > before:     # lift-offs and the like are normal; `problem` is not
            counts = ', '.join(f'{count} {cause}' for cause, count in causes.items())
            self.get_logger().info(f'points rejected so far: {counts}',
                                   throttle_duration_sec=10.0)

    def _renew_hints(self) -> None:
        arrivals = (self._inputs.arrivals
                    if self._inputs is not None and self.state == 'active' else None)
        self._hints.renew(self.session.config, arrivals, self.session.collecting,
                          [Hint(problem) for problem in (
                              self._sim_clock.problem,
                              '' if self._outputs is None else self._outputs.problem) if problem])

    def _why_fixed(self, name: str) -> str:
        if self.state == 'configuring' and name.startswith(('model.', 'session.')):
            return 'a bone is being loaded; wait until ~/status reports the end'
        if self.state == 'unconfigured' or not dict(settings())[name].metadata['fixed']:
            return ''
        return (f'{name} is read when the node is configured; call the transitions deactivate and '
                'cleanup, set it, then configure and activate')

    def _configure(self, config: Config) -> None:
        """Apply changed settings; raise `InputError`, changing nothing, if they cannot be used."""
        before = self.session.config
        reload_needed = self._reloader.reload_needed(config)
        if reload_needed:
            config = self._reloader.keep_places(config)
        inputs = self._inputs_for(config, before)
        place = self.events.begin(self.session.kept)
        try:
            self.files.move(config.session)
            try:
                self.session.configure(config)
            except InputError:
                self.files.move(before.session)
                raise
        except InputError:
            if inputs is not None and inputs is not self._inputs:
                inputs.destroy()
            raise
        after, flat = config.flat(), before.flat()
        changed = {name: value for name, value in after.items() if value != flat[name]}
        if changed:
            self.events.publish('parameters', place, request=changed)
        if reload_needed:
            self._reloader.start()
        if self._inputs is not None and inputs is not None:
            if inputs is not self._inputs:
                self._inputs.finish()
                self._inputs.destroy()
                self._inputs = inputs
                if self.state == 'active':
                    inputs.activate()
            inputs.configure(config)
        if self._outputs is not None and config.tf.rate != before.tf.rate:
            self._outputs.set_tf_rate(config.tf.rate)
        if config.live.enabled != before.live.enabled and self.state == 'active':
            self._start_live()
        elif self._live is not None:
            self._live.notify()
        self.publish_status_soon()

    def _inputs_for(self, config: Config, before: Config) -> Inputs | None:
        """Return subscriptions to the topics of ``config``; raise `InputError` if they fail."""
        if self._inputs is None or config.probe.topics == before.probe.topics:
            return self._inputs
        try:
            return Inputs(self, config, TipPublisher(self._tip, self.session),
                          self.events.last, self._inputs.types)
        except RCLError as error:       # such as a topic of another type in this process
            raise InputError(f'probe.topics: {error}; {", ".join(before.probe.topics)} is kept'
                             ) from None
