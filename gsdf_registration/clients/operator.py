# SPDX-License-Identifier: Apache-2.0
"""
A client of the node, for the demo, the benchmarks and the tests.

It calls the services of the node and receives its messages.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple

import rclpy
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from gsdf_registration.clients.service_client import ServiceClient
from gsdf_registration.common.result import InputError

# of the poses, status, points and markers of the node: late joiners receive the last message
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
NUMBERS = itertools.count(1)    # two nodes of one name in a process would share their logger


class Answer(NamedTuple):
    """The response of a service: whether it succeeded, and one sentence."""

    success: bool
    message: str


class Operator:
    """
    A client with its own ROS context; one created after a registration is a late joiner.

    Every call waits for its response. It raises `InputError` when that takes longer than
    ``patience`` seconds, or when ``alive`` returns False because the node has exited.
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
        self._clients: dict[str, ServiceClient] = {}

    def __enter__(self) -> Operator:
        """Return the operator itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Shut down the node and its context."""
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
        """Return the lifecycle state of the node."""
        response = self.result(self.start(GetState, 'get_state', GetState.Request()))
        return str(response.current_state.label)

    def start(self, kind: Any, service: str, request: Any) -> Any:
        """Send a request to ``~/service``; `result` waits for its response."""
        if service not in self._clients:
            self._clients[service] = ServiceClient(self.node, kind, self._target, service)
        client = self._clients[service]
        self.spin_until(client.is_ready, f'the service {service} is not available')
        return client.send(request)

    def result(self, future: Any) -> Any:
        """Return the response of a request sent by `start`."""
        self.spin_until(future.done, 'the node did not respond')
        return future.result()

    def _answer(self, future: Any) -> Answer:
        response = self.result(future)
        return Answer(response.success, response.message)

    def receive(self, kind: Any, topic: str, qos: QoSProfile | int = LATCHED,
                accept: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the first accepted message on ``topic``; ``~`` stands for the node's name."""
        received: list[Any] = []

        def on_message(message: Any) -> None:
            if accept(message):
                received.append(message)

        subscription = self.node.create_subscription(kind, topic.replace('~', self._target),
                                                     on_message, qos)
        try:
            self.spin_until(lambda: bool(received), f'no matching message arrived on {topic}')
        finally:
            self.node.destroy_subscription(subscription)
        return received[0]

    def spin_until(self, condition: Callable[[], bool], complaint: str) -> None:
        """
        Process messages until ``condition`` holds; it is checked at least 50 times a second.

        ``complaint`` says what did not happen, for the error message.
        """
        deadline = time.monotonic() + self.patience
        while not condition():
            if not self._alive():
                raise InputError('the node has exited')
            if time.monotonic() > deadline:
                raise InputError(f'{complaint} within {self.patience:g} s')
            self._executor.spin_once(timeout_sec=0.02)
