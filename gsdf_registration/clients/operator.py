# SPDX-License-Identifier: Apache-2.0
"""
A client of the node, for the demonstration and the tests.

Calls its services and hears what it says.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import rclpy
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from gsdf_registration.common.result import InputError
from gsdf_registration.node.qos import LATCHED
from gsdf_registration.session.landmark_capture import Answer

AGAIN = 2.0         # s without an answer after which a question that does no harm is asked again
NUMBERS = itertools.count(1)      # two nodes of one name in a process would share their log


class Operator:
    """
    A participant of its own: one made after a registration is a late joiner.

    Every call waits for what it asks for, and raises `InputError` when that takes longer than
    ``patience`` seconds, or ``alive`` says that the node has ended.
    """

    def __init__(self, node: str = '/registration', patience: float = 10.0,
                 alive: Callable[[], bool] = lambda: True) -> None:
        self.patience = patience
        self._alive = alive
        self._target = node
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(f'operator_{next(NUMBERS)}', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}

    def __enter__(self) -> Operator:
        """Return the operator itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def ask(self, service: str) -> Answer:
        """Call ``~/service`` without arguments."""
        return self._answer(self.start(Trigger, service, Trigger.Request()))

    def collect(self, on: bool) -> Answer:
        """Start or end a stroke."""
        return self._answer(self.start(SetBool, 'collect', SetBool.Request(data=on)))

    def state(self) -> str:
        """
        Return the lifecycle state of the node.

        It is asked for again and again: the answer is lost if the node does not know of us yet.
        """
        future, asked = None, -math.inf

        def answered() -> bool:
            nonlocal future, asked
            if time.monotonic() - asked > AGAIN:
                future = self.start(GetState, 'get_state', GetState.Request())
                asked = time.monotonic()
            return bool(future and future.done())
        self.spin_until(answered, 'the state was not told')
        assert future is not None
        return str(future.result().current_state.label)

    def start(self, kind: Any, service: str, request: Any) -> Any:
        """Send a request to ``~/service``; `result` waits for its response."""
        client = self._clients.get(service)
        if client is None:
            client = self._clients[service] = self.node.create_client(kind,
                                                                      f'{self._target}/{service}')
        self.spin_until(client.service_is_ready, f'{service} is not served')
        return client.call_async(request)

    def result(self, future: Any) -> Any:
        """Return the response of a request sent by `start`."""
        self.spin_until(future.done, 'no answer came')
        return future.result()

    def _answer(self, future: Any) -> Answer:
        response = self.result(future)
        return Answer(response.success, response.message)

    def hear(self, kind: Any, topic: str, qos: QoSProfile | int = LATCHED,
             accept: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the first message on ``topic`` that is accepted; ``~/`` is the node."""
        heard: list[Any] = []

        def listen(message: Any) -> None:
            if accept(message):
                heard.append(message)

        subscription = self.node.create_subscription(kind, topic.replace('~', self._target), listen,
                                                     qos)
        try:
            self.spin_until(lambda: bool(heard), f'nothing that fits was heard on {topic}')
        finally:
            self.node.destroy_subscription(subscription)
        return heard[0]

    def spin_until(self, condition: Callable[[], bool], complaint: str) -> None:
        """Let messages in until ``condition`` holds, looked at 50 times a second at least."""
        deadline = time.monotonic() + self.patience
        while not condition():
            if not self._alive():
                raise InputError('the node has ended')
            if time.monotonic() > deadline:
                raise InputError(f'{complaint} within {self.patience:g} s')
            self._executor.spin_once(timeout_sec=0.02)
