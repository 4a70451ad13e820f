# SPDX-License-Identifier: Apache-2.0
"""The std_srvs services: each calls the session and answers with success and one sentence."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import Executor
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_srvs.srv import SetBool, Trigger

from gsdf_registration.common.formatting import format_length
from gsdf_registration.common.operator_event import BUSY
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import Array, rms_displacement
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.node.background import BackgroundThread
from gsdf_registration.node.events import EventPublisher, request_values
from gsdf_registration.node.progress import Progress
from gsdf_registration.node.session_files import SessionFiles
from gsdf_registration.node.typed_services import typed_services
from gsdf_registration.session import Session
from gsdf_registration.session.calibration import CalibrationKind
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.status import Status
from gsdf_registration.session.status_values import pose_kept
from gsdf_registration.tracking.pivot import FixedPoint
from msg_adapters import results

Handler = Callable[[Any], Awaitable[Answer]]


class ServiceNode(Protocol):
    """The node, as far as the services use it."""

    session: Session
    files: SessionFiles
    events: EventPublisher
    cancelled: threading.Event      # set to cancel a running registration
    progress: Progress              # of the running registration

    @property
    def executor(self) -> Executor | None:
        """The executor that spins the node."""

    @property
    def field(self) -> Field | None:
        """The bone in use."""

    def get_logger(self) -> RcutilsLogger:
        """Return the logger of the node."""

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, *,
                       callback_group: Any) -> Any:
        """Create a service."""

    def now(self) -> float:
        """Return the time of the node's clock, s."""

    def refusal(self) -> str:
        """Return why requests are refused now; empty while the node is active."""

    def clear(self) -> Answer:
        """Start a new session."""

    def set_tip(self, tip: list[float], error: float | None) -> None:
        """Set ``probe.tip``, (3,) m, and ``probe.tip_error``, m; `InputError` if that fails."""

    def adopt_tip(self) -> None:
        """Set ``probe.tip`` to that of a session that was loaded."""

    def registration_finished(self, success: bool) -> None:
        """Report the end of a registration to the live registration."""

    def publish_status(self) -> None:
        """Publish ``~/status``, and the registration or its withdrawal, if they have changed."""


class Services:
    """
    Serves ``~/collect`` and the others, in every state of the node's lifecycle.

    They exist from the start, so a client of a node without a bone gets a reason and need not wait.
    """

    def __init__(self, node: ServiceNode) -> None:
        self._node = node
        self._background = BackgroundThread()
        # reentrant: ~/register awaits its solve while other requests, itself included, are answered
        group = ReentrantCallbackGroup()
        for handler in (self.collect, self.undo, self.clear, self.capture_landmark, self.register,
                        self.verify, self.save, self.load, self.calibrate_tip,
                        self.find_joint_centre):
            kind = SetBool if handler == self.collect else Trigger
            node.create_service(kind, f'~/{handler.__name__}',
                                self.callback(handler.__name__, handler), callback_group=group)
        if results.available():
            for service in typed_services(node, self):
                node.create_service(service.kind, f'~/{service.name}',
                                    self.callback(service.name, service.handler, service.fill),
                                    callback_group=group)

    def callback(self, name: str, handler: Handler,
                 fill: Callable[[Any, Answer], None] = lambda response, answer: None
                 ) -> Callable[[Any, Any], Awaitable[Any]]:
        """
        Return a service callback that answers with what ``handler`` returns.

        ``fill`` writes further fields of the response, also after a refusal.
        """
        log = self._node.get_logger().get_child(name.replace('/', '.'))

        async def serve(request: Any, response: Any) -> Any:
            node = self._node
            refusal, performed = node.refusal(), False
            place = node.events.begin(node.session.kept)
            try:
                answer = Answer(False, refusal) if refusal else await handler(request)
                performed = not refusal and self._performed(name, answer)
            except InputError as error:
                answer = Answer(False, error.message)
            # noqa: BLE001 - after an internal error the client still gets an answer
            except Exception as error:
                traceback.print_exc()
                answer = Answer(
                    False, f'internal error, please report it: {type(error).__name__}: {error}')
            if answer.success:
                log.info(answer.message)
            else:   # a client may repeat its request in a loop
                log.warning(answer.message, throttle_duration_sec=1.0)
            node.events.publish(name.removeprefix('typed/'), place, answer, request_values(request),
                                performed,
                                answer.detail if isinstance(answer.detail, str) else '')
            node.publish_status()
            response.success, response.message = answer.success, answer.message
            fill(response, answer)
            return response
        return serve

    def _performed(self, name: str, answer: Answer) -> bool:
        """Return whether the session carried a request out, see `OperatorEvent`."""
        if isinstance(answer.detail, RegistrationResult):
            return self._node.session.status().result is answer.detail
        if name.endswith(('verify', 'capture_landmark')):
            return answer.success or answer.detail is not None
        return True

    async def collect(self, request: SetBool.Request) -> Answer:
        """Start or end a stroke."""
        return self._node.session.collect(request.data)

    async def undo(self, _: Trigger.Request) -> Answer:
        """Drop the last stroke; if the pose used it, register again or withdraw it."""
        return await self.drop(lambda session: session.undo())

    async def drop(self, drop: Callable[[Session], Answer]) -> Answer:
        """Drop a stroke; if the pose used it, register again without it or withdraw the pose."""
        session = self._node.session
        before, dropped = session.status(), drop(session)
        # a registration that was outdated before did not use this stroke
        if not dropped.success or before.outdated or not session.status().outdated:
            return dropped
        used = f'{dropped.message}; the pose used it'
        attempted = 'withdrawn'
        if self._background.busy:
            why = 'register again when the current request is finished'
        else:
            found = await self._register(None)
            if found.success:
                return Answer(True, f'{dropped.message}; registered again without it: '
                              f'{self._moved_since(before)}; {found.message}', 'registered')
            if session.status().result is found:    # else it was cancelled
                attempted = 'refused'
            why = f'a registration without it is refused: {found.reason}: {found.message}'
        session.withdraw_pose(Withdrawal.POINTS_DROPPED,
                              f'a stroke that the pose used was dropped; {why}')
        return Answer(True, f'{used} and is withdrawn; {why}', attempted)

    def _moved_since(self, before: Status) -> str:
        """Return how far the registered bone is from its position ``before``."""
        now, then = self._node.session.status().pose_result, before.pose_result
        field = self._node.field
        assert now is not None and then is not None and field is not None
        assert now.T_tracker_bone is not None and then.T_tracker_bone is not None
        distance = rms_displacement(then.T_tracker_bone, now.T_tracker_bone,
                                    field.surface_points)
        return f'the bone moved by {format_length(distance)} (RMS)'

    async def clear(self, _: Trigger.Request) -> Answer:
        """Drop all points, landmarks and verification points, and withdraw the pose."""
        return self._node.clear()

    async def capture_landmark(self, _: Trigger.Request) -> Answer:
        """Capture the stationary tip as the next landmark."""
        return self._node.session.capture_landmark(self._node.now())

    async def verify(self, _: Trigger.Request) -> Answer:
        """
        Measure the distance of the stationary tip to the registered surface.

        If a checkpoint has moved by more than ``limits.verification``, the pose is withdrawn.
        """
        return self._node.session.verify(self._node.now())

    async def register(self, _: Trigger.Request) -> Answer:
        """Register the collected points, and publish the pose."""
        return await self.register_from(None)

    async def register_from(self, T_tracker_bone: Array | None) -> Answer:
        """Register from this initial pose (4, 4); the detail of the answer is the result."""
        session = self._node.session
        result = await self._register(T_tracker_bone)
        if not result.success:
            return Answer(False, f'{result.reason}: {result.message}{pose_kept(session.status())}',
                          result)
        if session is not self._node.session or self._node.refusal():
            return Answer(False, 'the node was stopped during the registration; nothing is '
                          'published')
        return Answer(True, result.message, result)

    async def _register(self, T_tracker_bone: Array | None) -> RegistrationResult:
        session, cancelled = self._node.session, self._node.cancelled
        progress = self._node.progress
        self._refuse_if_busy()
        job = session.start_registration(T_tracker_bone=T_tracker_bone,
                                         cancelled=cancelled.is_set, progress=progress.show)
        if isinstance(job, RegistrationResult):     # refused at once
            result = job
        else:
            try:
                result = await self._in_background(job)
            finally:
                progress.end()
        self._node.registration_finished(result.success)
        return result

    async def save(self, _: Trigger.Request) -> Answer:
        """Write the session to ``session.path``; another session that is there is kept."""
        session, files = self._node.session, self._node.files
        return Answer(True, await self._in_background(lambda: files.save(session)))

    async def load(self, _: Trigger.Request) -> Answer:
        """Restore the session in ``session.path``, and publish its registration."""
        session, files = self._node.session, self._node.files
        path = await self._in_background(lambda: files.load(session))
        self._node.adopt_tip()
        return Answer(True, f'session loaded from {path}: {session.status().message}')

    async def calibrate_tip(self, _: Trigger.Request) -> Answer:
        """
        Start to calibrate the tip of the probe; the next call ends it and sets the tip.

        ``probe.tip`` and ``probe.tip_error`` are also written beside ``session.path``, see
        `SessionFiles.save_tip`.
        """
        node, session = self._node, self._node.session
        answer = await self._start_or_end(session, CalibrationKind.TIP)
        found = answer.detail
        if not isinstance(found, FixedPoint) or found.point is None:
            return answer
        if session is not node.session:
            return Answer(False, 'the node was stopped during the calibration; nothing is set')
        node.set_tip(found.point.tolist(), found.rms_error)
        written = await self._in_background(lambda: node.files.save_tip(session, found))
        return Answer(True, f'{answer.message}; probe.tip and probe.tip_error are set{written}')

    async def find_joint_centre(self, _: Trigger.Request) -> Answer:
        """Start to find the centre of a joint from swinging; the next call ends it."""
        session = self._node.session
        return await self._start_or_end(session, CalibrationKind.JOINT_CENTRE)

    async def _start_or_end(self, session: Session, kind: CalibrationKind) -> Answer:
        """Start or end a calibration; its result is found in the background."""
        if session.calibrations.progress is not None:
            self._refuse_if_busy()
        answer = session.calibrations.begin_or_end(kind)
        if not isinstance(answer, Answer):
            answer = await self._in_background(answer)
        return answer

    async def _in_background(self, job: Callable[[], Any]) -> Any:
        executor = self._node.executor
        assert executor is not None     # it runs this callback
        self._refuse_if_busy()
        return await self._background.run(executor, job)

    def _refuse_if_busy(self) -> None:
        if self._background.busy:
            raise InputError(BUSY)

    def shutdown(self, timeout: float) -> bool:
        """Start no more jobs; return whether the running one ended within ``timeout`` seconds."""
        return self._background.shutdown(timeout)
