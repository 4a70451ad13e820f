# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM stop the node cleanly in every state, also twice in a row."""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from rclpy.parameter import Parameter
from ros_support import BAG, Client, NodeProcess, Tracker
from std_srvs.srv import Trigger

from gsdf_registration.clients.operator import Operator

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
STOP_TIMEOUT = 2.0      # s, as documented
BOTH = [signal.SIGINT, signal.SIGTERM]


def assert_stops(node: NodeProcess, *signals: signal.Signals) -> None:
    for number in signals:
        node.process.send_signal(number)
    assert node.process.wait(timeout=STOP_TIMEOUT) == 0
    assert 'Traceback' not in node.log


@pytest.mark.parametrize('state, signals', [
    ('unconfigured', [signal.SIGINT]),
    ('inactive', [signal.SIGTERM]),
    ('active', [signal.SIGINT, signal.SIGINT]),
    ('active', [signal.SIGTERM, signal.SIGTERM]),
], ids=['unconfigured', 'inactive', 'active, SIGINT twice', 'active, SIGTERM twice'])
def test_signal_stops_the_node(start_node: StartNode, parameters: dict[str, Any], state: str,
                                signals: list[signal.Signals]) -> None:
    node = start_node('stopped', **parameters | {'autostart': 'false'})
    with Client(node) as client:
        client.await_state('unconfigured')
        if state != 'unconfigured':
            assert client.change(Transition.TRANSITION_CONFIGURE)
        if state == 'active':
            assert client.change(Transition.TRANSITION_ACTIVATE)
    assert_stops(node, *signals)


def test_signals_stop_a_node_during_a_registration(
        start_node: StartNode, parameters: dict[str, Any], many_points: Path) -> None:
    node = start_node('solving', **parameters | {'session.path': many_points})
    with Client(node) as client:
        client.await_state('active')
        assert client.ask('load').success
        client.start(Trigger, 'register', Trigger.Request())
        assert 'wait' in client.ask('register').message     # the registration runs
        assert_stops(node, signal.SIGINT, signal.SIGTERM)


def test_signals_stop_a_node_that_loads_its_bone(
        start_node: StartNode, parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path))     # empty: the field must be built
    node = start_node('loading',
                      **parameters | {'autostart': 'false', 'model.voxel_size': '0.0003'})
    with Client(node) as client:
        client.await_state('unconfigured')
        client.begin(Transition.TRANSITION_CONFIGURE)
        client.spin_until(lambda: 'loading' in node.log, 'the bone is not being loaded')
        assert_stops(node, signal.SIGTERM, signal.SIGTERM)
    assert 'is loaded' not in node.log
    assert '[ERROR]' not in node.log


def test_stopped_node_disappears_from_the_graph(start_node: StartNode) -> None:
    node = start_node('gone')
    with Client(node) as client, Operator(node.name) as other:
        client.await_state('active')

        def in_graph() -> bool:
            return (node.name[1:], '/') in other.node.get_node_names_and_namespaces()
        other.spin_until(in_graph, 'the node is not in the graph')
        assert_stops(node, signal.SIGTERM)
        # a killed process stays in the graph until its lease ends after 20 s
        other.spin_until(lambda: not in_graph(), 'the node is still in the graph')


def await_blocked(node: NodeProcess) -> None:
    """
    Wait until the process blocks the signals, which it does before it imports rclpy.

    The main thread does not show this while it waits in sigwait, but another thread does.
    """
    tasks, wanted = Path(f'/proc/{node.process.pid}/task'), sum(1 << n - 1 for n in BOTH)
    while node.process.poll() is None:
        for status in tasks.glob('*/status'):
            with suppress(OSError):     # a thread that ends meanwhile
                blocked = re.search(r'SigBlk:\s*(\w+)', status.read_text())
                if blocked is not None and int(blocked[1], 16) & wanted == wanted:
                    return
        time.sleep(0.001)
    pytest.fail(f'the node ended: {node.log}')


def test_signals_stop_a_node_that_starts(start_node: StartNode,
                                                  parameters: dict[str, Any]) -> None:
    node = start_node('starting', **parameters)
    await_blocked(node)
    assert_stops(node, *BOTH)
    assert node.log == ''


def test_signals_stop_a_node_during_a_search_with_points_arriving(
        start_node: StartNode, parameters: dict[str, Any]) -> None:
    node = start_node('searching', **parameters | {'collect.automatic': 'true',
                                                 'probe.topics': ['/probe/tip']})
    with Client(node) as client:
        client.await_state('active')
        tracker = Tracker(client, topics=['/probe/tip'])
        tracker.await_listener()
        # enough points for a search, then more during it
        tracker.send(tracker.positions[:300], tracker.steps[:300])
        client.spin_until(lambda: client.status().get('live.points', '0') != '0' or
                          'searching' in client.status()['message'], 'there is no search')
        tracker.send(tracker.positions[300:400], tracker.steps[300:400])
        assert_stops(node, *BOTH)


def test_signals_stop_a_node_that_saves_and_the_file_is_complete(
        start_node: StartNode, parameters: dict[str, Any], many_points: Path) -> None:
    before = many_points.read_text()
    node = start_node('saving', **parameters | {'session.path': many_points})
    with Client(node) as client:
        client.await_state('active')
        assert client.ask('load').success
        client.start(Trigger, 'save', Trigger.Request())
        assert 'wait' in client.ask('save').message     # it is being saved
        assert_stops(node, *BOTH)
    assert len(json.loads(many_points.read_text())['points']) == len(json.loads(before)['points'])
    remaining = {file.name for file in many_points.parent.iterdir()
                 if not file.name.endswith('Z.json')} - {'log', 'log.journal'}      # kept sessions
    assert remaining <= {many_points.name, *(f'{many_points.name}.journal{end}'
                                        for end in ('', '.1', '.2'))}


def test_signals_stop_a_node_that_loads_another_bone(
        start_node: StartNode, parameters: dict[str, Any]) -> None:
    node = start_node('reloading', **parameters)
    with Client(node) as client:
        client.await_state('active')
        other = [Parameter('model.path', value=str(BAG.parent / 'femur.ply')),
                 Parameter('model.voxel_size', value=0.00023)]      # not in the cache
        assert client.set_parameters(*other) == ''
        client.spin_until(lambda: f'loading {other[0].value}' in node.log, 'it does not load')
        assert_stops(node, *BOTH)
    assert f'{other[0].value} is loaded' not in node.log


def test_signals_stop_a_node_that_is_being_deactivated(start_node: StartNode,
                                                parameters: dict[str, Any]) -> None:
    node = start_node('deactivated', **parameters)
    with Client(node) as client:
        client.await_state('active')
        client.begin(Transition.TRANSITION_DEACTIVATE)
        assert_stops(node, *BOTH)
