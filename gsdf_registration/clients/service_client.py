# SPDX-License-Identifier: Apache-2.0
"""
A client of a service that sends a request only when the response can arrive.

A service can take a request before it has discovered the client's reader of the response. The
response is then dropped, see https://github.com/ros2/rmw_fastrtps/issues/842, and a client sees
only its own side of the discovery. So the node is first asked something harmless, by a client that
is created later: a participant announces its readers in order on a reliable topic (DDSI-RTPS
8.5.4), so a node that answers the later client has discovered the earlier one.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

REPEAT = 0.5    # s without a response, after which the harmless request is repeated


class ServiceClient:
    """
    Calls ``service`` of the node ``target`` from ``node``, which somebody spins; thread-safe.

    A request is sent once: whoever repeats it must know that it may be carried out twice.
    """

    def __init__(self, node: Node, kind: Any, target: str, service: str) -> None:
        self._node, self._target = node, target
        self._service = f'{target}/{service}'
        self._client = node.create_client(kind, self._service)
        self._proven: set[bytes] | None = None      # servers when the last probe was answered
        self._probe: _Probe | None = None
        self._lock = threading.Lock()

    def is_ready(self) -> bool:
        """Return whether a response would arrive; to be called again and again until it would."""
        with self._lock:
            if not self._client.service_is_ready():
                return False
            servers = _servers(self._node, self._service)
            if servers != self._proven:     # one that has come may not have discovered us
                self._probe = self._probe or _Probe(self._node, self._target)
                if self._probe.answered() and len(servers) >= self._probe.servers():
                    self._proven = servers
                    self._probe.end()
                    self._probe = None
            return servers == self._proven

    def send(self, request: Any) -> Any:
        """Send a request; return the future of its response."""
        return self._client.call_async(request)


class _Probe:
    """Asks a node for the values of no parameters until a response arrives."""

    def __init__(self, node: Node, target: str) -> None:
        self._node, self._service = node, f'{target}/get_parameters'
        self._client = node.create_client(GetParameters, self._service)
        self._responses: list[Any] = []
        self._asked = -math.inf

    def servers(self) -> int:
        """Return how many there are: a killed node stays in the graph, so there may be two."""
        return len(_servers(self._node, self._service))

    def answered(self) -> bool:
        """Return whether a response has arrived; ask, and ask again, if not."""
        if self._client.service_is_ready() and time.monotonic() - self._asked > REPEAT:
            self._responses.append(self._client.call_async(GetParameters.Request()))
            self._asked = time.monotonic()
        return any(response.done() for response in self._responses)

    def end(self) -> None:
        """Destroy the client."""
        self._node.destroy_client(self._client)


def _servers(node: Node, service: str) -> set[bytes]:
    """Return the identifiers of the servers of a service that ``node`` has discovered."""
    return {bytes(each.endpoint_gid) for each in node.get_subscriptions_info_by_topic(
        f'rq{service}Request', no_mangle=True)}
