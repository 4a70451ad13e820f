# SPDX-License-Identifier: Apache-2.0
"""Test the bridge between OpenIGTLink and ROS with the server and the client of pyigtl."""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyigtl
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from waiting import until

from gsdf_registration.cli.main import main
from gsdf_registration.clients.igtl_bridge import LATCHED, TURNS, Bridge, topics_of
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import exp
from msg_adapters.igtl import PoseServer, ToolStream
from msg_adapters.ros import pose_from, pose_msg, seconds_to_stamp

pytestmark = pytest.mark.ros
T = exp([0.3, -0.5, 0.8, 0.1, 0.25, -0.4])
SCALE = np.diag([1e3, 1e3, 1e3, 1.0])
IN_MM = SCALE @ T @ np.linalg.inv(SCALE)


@pytest.fixture
def ports() -> Iterator[tuple[int, int]]:
    handlers = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    with socket.socket() as one, socket.socket() as other:
        for free in (one, other):
            free.bind(('127.0.0.1', 0))
        numbers = one.getsockname()[1], other.getsockname()[1]
    yield numbers
    for each, handler in handlers.items():      # the server of pyigtl replaces them
        signal.signal(each, handler)


@pytest.fixture
def context() -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.shutdown()


def test_bridges_tools_to_topics_and_the_bone_to_a_client(
        ports: tuple[int, int], context: None, capsys: pytest.CaptureFixture[str]) -> None:
    plus, slicer = pyigtl.OpenIGTLinkServer(port=ports[0]), None
    other, received = Node('other'), {'/probe/measured_cp': [], '/reference/measured_cp': []}
    for topic, messages in received.items():
        other.create_subscription(PoseStamped, topic, messages.append, 10)
    bone = other.create_publisher(PoseStamped, '/knee/bone_pose', LATCHED)
    status = other.create_publisher(DiagnosticStatus, '/knee/status', LATCHED)
    topics = topics_of(['ProbeToCamera', 'RefToCamera=/reference/measured_cp'])

    def send() -> None:
        for device in (*topics, 'IgnoredToCamera'):
            plus.send_message(pyigtl.TransformMessage(IN_MM, 12.5, device), wait=False)

    def listen() -> None:
        rclpy.spin_once(other, timeout_sec=0.0)
    try:
        with PoseServer(ports[1]) as server, ToolStream('127.0.0.1', ports[0]) as stream:
            bridge = Bridge(Node('igtl_bridge'), stream, topics, server=server,
                            registration='/knee')
            slicer = pyigtl.OpenIGTLinkClient('127.0.0.1', ports[1])
            until(lambda: all(received.values()), send, bridge.step, listen)
            stamp, found, frame = pose_from(received['/probe/measured_cp'][0])
            np.testing.assert_allclose(found, T, atol=1e-6)
            assert (stamp, frame) == (12.5, 'camera') and set(bridge.counts) == set(topics)

            bone.publish(pose_msg(T, 'camera', seconds_to_stamp(3.0)))
            status.publish(DiagnosticStatus(values=[KeyValue(key='pose', value='in camera')]))
            got: list[Any] = []

            def look() -> None:
                got.extend(each for each in slicer.get_latest_messages()
                           if each.device_name == 'BoneToCamera')
            until(lambda: got, bridge.step, look)
            # Slicer shows a model in LPS in RAS
            np.testing.assert_allclose(got[0].matrix @ SCALE,
                                       SCALE @ T @ TURNS['lps'], rtol=1e-5, atol=1e-3)
            status.publish(DiagnosticStatus(values=[KeyValue(key='pose', value='none')]))
            until(lambda: bridge._bone is None, bridge.step)
    finally:
        plus.stop()
        if slicer is not None:
            slicer.stop()
    assert 'ProbeToCamera: published on /probe/measured_cp in frame camera' in \
        capsys.readouterr().out
    assert 'RefToCamera: ' in bridge.summary()


def test_names_a_tool_that_is_not_valid(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match='give DEVICE or DEVICE=/TOPIC'):
        topics_of(['StylusToTracker=probe'])
    assert main(['igtl', '--tool', '=/probe']) == 2
    assert capsys.readouterr().err.count('\n') == 1
