# SPDX-License-Identifier: Apache-2.0
"""The private services: each asks the session, and answers with success and one plain sentence."""

from __future__ import annotations

import traceback
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import SetBool, Trigger

from gsdf_registration.common.result import InputError
from gsdf_registration.node.status import pose_kept
from gsdf_registration.node.worker import Worker
from gsdf_registration.session.landmark_capture import Answer
from msg_adapters.session_file import read_session, write_session

if TYPE_CHECKING:
    from gsdf_registration.node.node import RegistrationNode

Handler = Callable[[Any], Awaitable[Answer]]


class Services:
    """
    Serves ``~/collect`` and the others on a node, in every state of its lifecycle.

    They are there from the start, so a client of a node without a bone is told and need not wait.
    """

    def __init__(self, node: RegistrationNode) -> None:
        self._node = node
        self._worker = Worker()
        # reentrant: ~/register waits for its solve while the others, itself included, are answered
        group = ReentrantCallbackGroup()
        for handler in (self.collect, self.undo, self.clear, self.capture_landmark, self.register,
                        self.verify, self.save, self.load):
            kind = SetBool if handler == self.collect else Trigger
            node.create_service(kind,
                                f'~/{handler.__name__}',
                                self._served(handler),
                                callback_group=group)

    def _served(self, handler: Handler) -> Callable[[Any, Any], Awaitable[Any]]:
        log = self._node.get_logger().get_child(handler.__name__)

        async def serve(request: Any, response: Any) -> Any:
            node = self._node
            refusal = node.refusal()
            try:
                answer = Answer(False, refusal) if refusal else await handler(request)
            except InputError as error:
                answer = Answer(False, error.message)
            # noqa: BLE001 - a fault of ours must cost neither the client its answer nor the points
            except Exception as error:
                traceback.print_exc()
                answer = Answer(
                    False, f'internal error, please report it: {type(error).__name__}: {error}')
            if answer.success:
                log.info(answer.message)
            else:   # who asks again and again is told each time, the log once in a while
                log.warning(answer.message, throttle_duration_sec=1.0)
            node.live.wake()
            node.show()
            response.success, response.message = answer.success, answer.message
            return response
        return serve

    async def collect(self, request: SetBool.Request) -> Answer:
        """Start or end a stroke."""
        return self._node.session.collect(request.data)

    async def undo(self, _: Trigger.Request) -> Answer:
        """Drop the last stroke, and register anew if the last good pose was found with it."""
        session = self._node.session
        before, dropped = session.status(), session.undo()
        self._node.live.wake()
        # a pose that was outdated before, as after ~/clear, is not what was undone
        if not dropped.success or before.outdated or not session.status().outdated:
            return dropped
        if self._worker.busy:
            return Answer(True, f'{dropped.message}; the last good pose was found with it: '
                          'register again when the last request is done')
        found = await self.register(Trigger.Request())
        if not found.success:
            return Answer(True, f'{dropped.message}; the last good pose was found with it, and '
                          f'without it there is none: {found.message}')
        return Answer(True, f'{dropped.message}; registered anew without it: '
                      f'{self._node.moved_since(before)}; {found.message}')

    async def clear(self, _: Trigger.Request) -> Answer:
        """Drop all points, landmarks and verification points."""
        return self._node.clear()

    async def capture_landmark(self, _: Trigger.Request) -> Answer:
        """Take the resting tip as the next landmark."""
        return self._node.session.capture_landmark(self._node.now())

    async def verify(self, _: Trigger.Request) -> Answer:
        """Measure the distance of the resting tip to the registered surface."""
        return self._node.session.verify(self._node.now())

    async def register(self, _: Trigger.Request) -> Answer:
        """Solve, and publish the pose."""
        session, cancelled = self._node.session, self._node.cancelled
        result = await self._off_executor(lambda: session.register(cancelled=cancelled.is_set))
        self._node.live.registered(result.success)
        if not result.success:
            return Answer(False, f'{result.reason}: {result.message}{pose_kept(session.status())}')
        if session is not self._node.session or self._node.refusal():
            return Answer(False, 'the node was stopped meanwhile; nothing is published')
        self._node.publish_pose()
        return Answer(True, result.message)

    async def save(self, _: Trigger.Request) -> Answer:
        """Write the session to ``session.path``."""
        session, path = self._node.session, self._node.config.session.path
        await self._off_executor(lambda: write_session(path, session.to_dict()))
        return Answer(True, f'session saved to {path}')

    async def load(self, _: Trigger.Request) -> Answer:
        """Take up the session in ``session.path``, and publish its pose."""
        session, path = self._node.session, self._node.config.session.path
        await self._off_executor(lambda: session.restore(read_session(path)))
        self._node.publish_pose()
        return Answer(True, f'session loaded from {path}: {session.status().message}')

    async def _off_executor(self, job: Callable[[], Any]) -> Any:
        executor = self._node.executor
        assert executor is not None     # it calls us
        if self._worker.busy:
            raise InputError('the last request is still being worked on; wait for its answer')
        return await self._worker.run(executor, job)

    def idle(self, timeout: float) -> bool:
        """Take no further jobs; tell whether the running one ended within ``timeout`` seconds."""
        return self._worker.shutdown(timeout)
