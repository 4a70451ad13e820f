# SPDX-License-Identifier: Apache-2.0
"""What the launch file runs to play a recording once the node is active."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from ros_support import NodeProcess, Tracker

COMMAND = [sys.executable, '-m', 'gsdf_registration.clients.play_when_active']
pytestmark = pytest.mark.ros


def test_runs_the_command_once_the_node_is_active(shared_node: NodeProcess,
                                                  shared_tracker: Tracker) -> None:
    done = subprocess.run([*COMMAND, shared_node.name, 'echo', 'played', '--rate', '2'],
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == 'played --rate 2'


def test_says_that_the_node_did_not_become_active() -> None:
    done = subprocess.run([*COMMAND, '--timeout', '0', '/no/body', 'echo', 'played'],
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr == ('/no/body did not become active within 0 s (it does not answer); '
                           'nothing is played\n')
    assert 'played' not in done.stdout


def test_a_signal_ends_it_at_once() -> None:
    waiting = subprocess.Popen([*COMMAND, '/no/body', 'echo', 'played'], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert waiting.stdout is not None
    assert waiting.stdout.readline() == ('waiting at most 180 s for /no/body to become active: it '
                                         'does not answer\n')
    start = time.monotonic()
    waiting.send_signal(signal.SIGINT)
    _, errors = waiting.communicate(timeout=30)
    assert waiting.returncode == 0 and errors == ''
    assert time.monotonic() - start < 2.0
