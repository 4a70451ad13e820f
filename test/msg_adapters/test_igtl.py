# SPDX-License-Identifier: Apache-2.0
"""Test the tool transforms of an OpenIGTLink server with the server of pyigtl."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator

import numpy as np
import pyigtl
import pytest
from waiting import until

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import exp
from msg_adapters.igtl import PoseServer, ToolReading, ToolStream, frames_of, ros_name

T = exp([0.3, -0.5, 0.8, 0.1, 0.25, -0.4])
IN_MM = np.diag([1e3, 1e3, 1e3, 1.0]) @ T @ np.diag([1e-3, 1e-3, 1e-3, 1.0])


@pytest.fixture
def port() -> Iterator[int]:
    """Return a free port; the server of pyigtl replaces signal handlers, which are restored."""
    handlers = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        number = free.getsockname()[1]
    yield number
    for each, handler in handlers.items():
        signal.signal(each, handler)


def transform(device: str = 'StylusToTracker', matrix: np.ndarray = IN_MM, stamp: float = 12.5,
              **metadata: str) -> pyigtl.TransformMessage:
    message = pyigtl.TransformMessage(matrix, timestamp=stamp, device_name=device)
    message.header_version, message.metadata = 2, metadata
    return message


def collect(stream: ToolStream, count: int) -> list[ToolReading]:
    """Return readings until there are ``count``, for at most 20 s."""
    readings: list[ToolReading] = []
    deadline = time.monotonic() + 20.0
    while len(readings) < count and time.monotonic() < deadline:
        readings += stream.receive(0.05)
    return readings


def test_receives_every_transform_of_a_server(port: int) -> None:
    server = pyigtl.OpenIGTLinkServer(port=port)
    try:
        with ToolStream('127.0.0.1', port) as stream:
            until(server.is_connected)
            for i in range(90):     # pyigtl keeps the last 100 messages that it has to send
                server.send_message(transform(stamp=100.0 + i), wait=False)
            server.send_message(transform('ReferenceToTracker', np.eye(4)), wait=False)
            readings = collect(stream, 91)
    finally:
        server.stop()
    assert [reading.stamp for reading in readings[:-1]] == [100.0 + i for i in range(90)]
    assert {reading.device for reading in readings} == {'StylusToTracker', 'ReferenceToTracker'}
    np.testing.assert_allclose(readings[0].T_tracker_tool, T, atol=1e-6)
    assert not stream.dropped


def test_transforms_of_tools_that_are_not_tracked_are_counted(port: int) -> None:
    server = pyigtl.OpenIGTLinkServer(port=port)
    bad = np.array(IN_MM)
    bad[0, 0] = np.nan
    try:
        with ToolStream('127.0.0.1', port) as stream:
            until(server.is_connected)
            for message in (transform(TransformStatus='OUT_OF_VIEW', TransformValid='false'),
                            transform(TransformValid='false'), transform(matrix=bad),
                            pyigtl.StringMessage('hello', device_name='Text'),
                            transform(TransformStatus='OK', TransformValid='true')):
                server.send_message(message, wait=False)
            assert len(collect(stream, 1)) == 1
            assert dict(stream.dropped) == {('StylusToTracker', 'tracking_state'): 2,
                                            ('StylusToTracker', 'not_rigid'): 1}
    finally:
        server.stop()


def test_connects_again_after_the_server_was_restarted(port: int) -> None:
    with ToolStream('127.0.0.1', port) as stream:
        for stamp in (1.0, 2.0):
            server = pyigtl.OpenIGTLinkServer(port=port)
            received: list[ToolReading] = []

            def send_and_receive(server: pyigtl.OpenIGTLinkServer = server, stamp: float = stamp,
                                 received: list[ToolReading] = received) -> None:
                server.send_message(transform(stamp=stamp), wait=False)
                received.extend(stream.receive(0.1))
            until(lambda received=received: bool(received), send_and_receive)
            assert received[0].stamp == stamp
            server.stop()


def test_sends_poses_to_a_client(port: int) -> None:
    with PoseServer(port) as server:
        client = pyigtl.OpenIGTLinkClient('127.0.0.1', port)
        received: list[pyigtl.TransformMessage] = []

        def send_and_receive() -> None:
            server.send('BoneToTracker', 3.5, T)
            received.extend(filter(None, [client.wait_for_message('BoneToTracker', 0.1)]))
        until(lambda: bool(received), send_and_receive)
        client.stop()
    np.testing.assert_allclose(received[0].matrix, IN_MM, atol=1e-4)
    assert received[0].timestamp == 3.5


def test_a_port_that_is_in_use_is_named(port: int) -> None:
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', port))
        taken.listen()
        with pytest.raises(InputError, match=f'port {port} cannot be used'):
            PoseServer(port)


def test_frames_are_named_after_the_transform() -> None:
    assert frames_of('StylusTipToReference') == ('stylus_tip', 'reference')
    assert frames_of('Tool-1ToTracker') == ('tool_1', 'tracker')
    assert frames_of('Probe') == ('probe', 'tracker')
    assert ros_name('8700339') == 'tool_8700339'
