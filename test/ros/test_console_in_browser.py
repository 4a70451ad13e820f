# SPDX-License-Identifier: Apache-2.0
"""The operator's console in a real browser, with a real node and the recorded probe behind it."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import CHROMIUM, MISSING, Watched, open_browser
from ros_support import ENDS_WITH_TESTS, Client, NodeProcess, Tracker
from std_msgs.msg import Empty

from gsdf_registration.visualization.web_access import free_port

pytestmark = [pytest.mark.ros, pytest.mark.timeout(400),
              pytest.mark.skipif(CHROMIUM is None, reason=MISSING)]


class Console:
    """The process of the console, and its address."""

    def __init__(self, node: str, *options: str) -> None:
        self._process = subprocess.Popen(
            [*ENDS_WITH_TESTS, sys.executable, '-m', 'gsdf_registration.node.console', '--node',
             node, '--port', str(free_port()), *options], stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self.url = next(line.split('open ')[1].strip() for line in self._process.stdout
                        if 'open http' in line)

    def stop(self) -> int:
        """Stop the process; return its exit status."""
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait(30)


@contextmanager
def held(tracker: Tracker, place: np.ndarray) -> Iterator[None]:
    """Hold the tip at a place (3,), m, until the end of the block."""
    end = threading.Event()

    def hold() -> None:
        while not end.wait(0.05):
            tracker.send(np.tile(place, (4, 1)))
    thread = threading.Thread(target=hold)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def verified(console: Watched, client: Client) -> bool:
    """Press the button; return whether there is a verification point."""
    console.press('Verify')
    return 'verification' in client.status()


def test_an_operator_registers_verifies_and_undoes_in_the_browser(
        start_node: Callable[..., NodeProcess], parameters: dict[str, Any], tmp_path: Path) -> None:
    given = parameters | {'collect.automatic': 'true', 'landmarks.names': '[]',
                          'landmarks.positions': '[]', 'session.path': tmp_path / 'session.json'}
    node = start_node('shown', **given)
    console = Console(node.name, '--ros-args', '-p', 'pedal.undo:=/pedal')
    try:
        with open_browser() as browser, Client(node) as client:
            client.await_state('active')
            tracker = Tracker(client)
            tracker.await_listener()
            desk, phone = (Watched(browser, console.url, *size) for size in (
                (1280, 800), (390, 844)))
            desk.shows('Collecting')
            tracker.send(tracker.positions, tracker.steps)
            desk.shows('Ready to register')
            desk.press('Register')
            for each in desk, phone:        # it may be opened twice
                each.shows('Registered: grade A')
            desk.shows('Error on the whole bone (95 %)')
            assert desk.bright_pixels(tmp_path / 'desk.png') > 5000, 'the canvas is blank'
            assert phone.bright_pixels(tmp_path / 'phone.png') > 1000, 'the canvas is blank'

            with held(tracker, tracker.positions[300]):
                client.spin_until(lambda: verified(desk, client), 'no point is verified')
            desk.open('Verify')
            desk.shows('Point 1')
            pedal = client.node.create_publisher(Empty, '/pedal', 10)
            client.spin_until(pedal.get_subscription_count, 'the pedal has no listener')
            before = int(client.status()['strokes'])
            pedal.publish(Empty())
            client.spin_until(lambda: int(client.status()['strokes']) < before,
                              'the pedal does not undo')
            desk.shows(re.compile('^dropped the last stroke'))
            desk.press('Undo stroke')
            client.spin_until(lambda: int(client.status()['strokes']) < before - 1,
                              'the button does not undo')

            node.process.terminate()
            node.process.wait(30)
            desk.shows('No connection to the node')
            again = start_node('shown', **given)
            with Client(again) as other:
                other.await_state('active')
                desk.shows(re.compile('Collecting|Registered|Ready'))
            for each in desk, phone:
                assert each.errors == [] and each.foreign == []
    finally:
        assert console.stop() == 0
