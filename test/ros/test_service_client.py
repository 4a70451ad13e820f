# SPDX-License-Identifier: Apache-2.0
"""A request that must not be repeated is sent only to a node that can send its response."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters
from std_srvs.srv import Trigger

from gsdf_registration.clients.operator import Operator

pytestmark = pytest.mark.ros
LOST = 2        # responses to the harmless request


class SlowServer:
    """Serves ``/slow/register`` and drops all responses until it has discovered the client."""

    def __init__(self, node: Any) -> None:
        self.asked = self.registered = 0
        self._node = node
        self._services = [node.create_service(GetParameters, '/slow/get_parameters', self._answer),
                          node.create_service(Trigger, '/slow/register', self._register)]
        for service in self._services:
            service.send_response = self._dropping(service.send_response)

    def _dropping(self, send: Any) -> Any:
        def send_response(response: Any, header: Any) -> None:
            if self.asked > LOST:
                send(response, header)
        return send_response

    def _answer(self, _: Any, response: GetParameters.Response) -> GetParameters.Response:
        self.asked += 1
        return response

    def _register(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        self.registered += 1
        response.success, response.message = True, 'registered'
        return response

    def stop(self) -> None:
        for each in self._services:
            self._node.destroy_service(each)


@pytest.fixture
def operator() -> Iterator[Operator]:
    """Return an operator whose ROS node can serve ``/slow``, too: one executor spins both."""
    with Operator('/slow', patience=15.0) as operator:
        yield operator


def test_asks_something_harmless_until_a_response_arrives(operator: Operator) -> None:
    server = SlowServer(operator.node)
    assert operator.ask('register') == (True, 'registered')
    assert (server.asked, server.registered) == (LOST + 1, 1)
    assert operator.ask('register').success
    assert (server.asked, server.registered) == (LOST + 1, 2)


def test_asks_a_node_that_was_started_again(operator: Operator) -> None:
    before = SlowServer(operator.node)
    assert operator.ask('register').success
    before.stop()
    server = SlowServer(operator.node)
    assert operator.ask('register').success
    assert (server.asked, server.registered) == (LOST + 1, 1)


def test_the_client_that_asks_is_created_last(operator: Operator,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    created: list[str] = []
    create_client = operator.node.create_client

    def recording(kind: Any, name: str) -> Any:
        created.append(name)
        return create_client(kind, name)
    monkeypatch.setattr(operator.node, 'create_client', recording)
    SlowServer(operator.node)
    assert operator.ask('register').success
    assert created == ['/slow/register', '/slow/get_parameters']
    assert [each.srv_name for each in operator.node.clients] == created[:1]     # it is destroyed
