# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM end the node cleanly in every state, also twice in a row."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from ros_support import Client, NodeProcess
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
SOON = 2.0      # s, the contract


def assert_ends(node: NodeProcess, *signals: signal.Signals) -> None:
    for number in signals:
        node.process.send_signal(number)
    assert node.process.wait(timeout=SOON) == 0
    assert 'Traceback' not in node.log


@pytest.mark.parametrize('state, signals', [
    ('unconfigured', [signal.SIGINT]),
    ('inactive', [signal.SIGTERM]),
    ('active', [signal.SIGINT, signal.SIGINT]),
    ('active', [signal.SIGTERM, signal.SIGTERM]),
], ids=['unconfigured', 'inactive', 'active, SIGINT twice', 'active, SIGTERM twice'])
def test_a_signal_ends_the_node(start_node: StartNode, parameters: dict[str, Any], state: str,
                                signals: list[signal.Signals]) -> None:
    node = start_node('ended', **parameters | {'autostart': 'false'})
    with Client(node) as client:
        client.await_state('unconfigured')
        if state != 'unconfigured':
            assert client.change(Transition.TRANSITION_CONFIGURE)
        if state == 'active':
            assert client.change(Transition.TRANSITION_ACTIVATE)
    assert_ends(node, *signals)


def test_signals_end_a_node_that_is_solving(start_node: StartNode, parameters: dict[str, Any],
                                            many_points: Path) -> None:
    node = start_node('solving', **parameters | {'session.path': many_points})
    with Client(node) as client:
        client.await_state('active')
        assert client.ask('load').success
        client.start(Trigger, 'register', Trigger.Request())
        assert 'wait' in client.ask('register').message     # so it is solving
        assert_ends(node, signal.SIGINT, signal.SIGTERM)


def test_signals_end_a_node_that_is_loading_its_bone(
        start_node: StartNode, parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path))     # nothing there: the field must be built
    node = start_node('loading',
                      **parameters | {'autostart': 'false', 'model.voxel_size': '0.0003'})
    with Client(node) as client:
        client.await_state('unconfigured')
        client.begin(Transition.TRANSITION_CONFIGURE)
        client.spin_until(lambda: 'loading' in node.log, 'it does not load')
        assert_ends(node, signal.SIGTERM, signal.SIGTERM)
    assert 'is loaded' not in node.log
    assert '[ERROR]' not in node.log
