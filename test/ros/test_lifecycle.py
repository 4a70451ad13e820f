# SPDX-License-Identifier: Apache-2.0
"""Lifecycle states of the node and its behaviour in each."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from rclpy.parameter import Parameter
from ros_support import Client, NodeProcess, Tracker

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]

UNCONFIGURED = 'the node is unconfigured; configure and activate it first'


def test_goes_through_all_states_for_a_lifecycle_manager(start_node: StartNode,
                                                  parameters: dict[str, Any]) -> None:
    node = start_node('managed', **parameters | {'autostart': 'false', 'collect.automatic': 'true'})
    with Client(node) as client:
        assert client.state() == 'unconfigured'
        assert client.ask('register').message == UNCONFIGURED
        for transition, state in ((Transition.TRANSITION_CONFIGURE, 'inactive'),
                                  (Transition.TRANSITION_ACTIVATE, 'active'),
                                  (Transition.TRANSITION_DEACTIVATE, 'inactive')):
            assert client.change(transition)
            assert client.state() == state
            assert client.ask('undo').message == ('there is no stroke to undo' if state == 'active'
                                                  else 'the node is inactive; activate it first')
        tracker = Tracker(client)

        assert client.change(Transition.TRANSITION_ACTIVATE)
        tracker.await_listener()
        tracker.send(tracker.positions[:10])
        kept = client.status(state='collecting', kept='10')['received']
        assert client.change(Transition.TRANSITION_DEACTIVATE)
        tracker.send(tracker.positions[10:30])      # an inactive node receives and ignores them
        tracker.await_processed(20)
        assert client.change(Transition.TRANSITION_ACTIVATE)
        tracker.send(tracker.positions[30:31])
        assert client.status(kept='11')['received'] == str(int(kept) + 1)

        assert client.change(Transition.TRANSITION_DEACTIVATE)
        assert client.change(Transition.TRANSITION_CLEANUP)
        assert client.status(received='0')['message'] == UNCONFIGURED
        assert client.change(Transition.TRANSITION_CONFIGURE)
        assert client.change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
        assert client.state() == 'finalized'
        assert client.ask('register').message == 'the node is finalized; start a new one'
    node.process.send_signal(signal.SIGTERM)
    assert node.process.wait(timeout=2.0) == 0


@pytest.mark.parametrize('path, message', [
    ('no/such/bone.stl', 'no/such/bone.stl'),
    ('package://no_such_package/bone.stl', 'no_such_package'),
])
def test_reports_a_model_that_cannot_be_loaded_and_accepts_another(
        start_node: StartNode, parameters: dict[str, Any], path: str, message: str) -> None:
    node = start_node('corrected', **parameters | {'model.path': path})
    with Client(node) as client:
        status = client.status(state='no_model', reason='no_model')
        assert message in status['message']
        assert client.state() == 'unconfigured'
        answer = client.ask('register')
        assert not answer.success
        assert answer.message == status['message']
        assert 'Traceback' not in node.log
        good = Parameter('model.path', Parameter.Type.STRING, str(parameters['model.path']))
        assert client.set_parameters(good) == ''
        assert client.change(Transition.TRANSITION_CONFIGURE)
        assert client.change(Transition.TRANSITION_ACTIVATE)
        client.status(state='idle')


def test_collects_points_but_does_not_register_without_a_model(
        start_node: StartNode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # nor has it gsdf_registration_msgs: a package without messages stands before it
    hidden = tmp_path / 'gsdf_registration_msgs'
    hidden.mkdir()
    (hidden / '__init__.py').touch()
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    node = start_node('bare')
    with Client(node) as client:
        client.await_state('active')
        tracker = Tracker(client, topics=['/probe/tip'])
        tracker.await_listener()
        tracker.send(tracker.positions[:40])
        client.status(state='no_model', kept='40')
        answer = client.ask('register')
        assert not answer.success
        assert answer.message.startswith('no_model: ')
        topics = {name for name, _ in client.node.get_topic_names_and_types()}
        assert '/bare/status' in topics and not topics & {'/bare/result', '/bare/guidance'}
        assert node.log.count('gsdf_registration_msgs is not installed') == 1


def test_answers_while_kernels_compile(start_node: StartNode, parameters: dict[str, Any],
                                       tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = tmp_path / 'kernels'
    kernels.mkdir()
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(kernels))
    node = start_node('compiling', **parameters)
    with Client(node) as client:
        client.spin_until(
            lambda: 'compiling, once on this machine (' in client.ask('register').message,
            'no progress is reported')
        assert client.state() == 'configuring'
        assert not client.change(Transition.TRANSITION_CONFIGURE)
        unit = Parameter('model.unit', Parameter.Type.STRING, 'm')
        assert 'a bone is being loaded' in client.set_parameters(unit)
        assert client.set_parameters(Parameter('gate.max_gap', Parameter.Type.DOUBLE, 0.4)) == ''
        assert 'compiling' in client.status()['message']
        node.process.send_signal(signal.SIGTERM)
        assert node.process.wait(timeout=2.0) == 0

    own, deadline = Path(f'/proc/{os.getpid()}/environ'), time.monotonic() + 30.0
    while any(str(kernels).encode() in _content(file)
              for file in Path('/proc').glob('[0-9]*/environ') if file != own):
        assert time.monotonic() < deadline, 'the compilation goes on without the node'


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError:     # of another user, or the process has ended
        return b''
