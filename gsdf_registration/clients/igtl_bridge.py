# SPDX-License-Identifier: Apache-2.0
"""
Bridge OpenIGTLink and ROS, for ``gsdf igtl``.

The tool transforms of a PLUS server become PoseStamped topics, and the pose of the bone and the
tools are sent to Slicer.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters.igtl import NAME_LENGTH, PoseServer, ToolReading, ToolStream, frames_of
from msg_adapters.ros import pose_from, pose_msg, seconds_to_stamp

# a late joiner receives the pose, as from the node
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
WAIT = 0.01         # s, for a message of the server
REPEAT = 1.0        # s between two messages with the pose of the bone, for a client that comes late
# OpenIGTLink has the axes RAS; a model in LPS is turned about z
TURNS = {'ras': np.eye(4), 'lps': np.diag([-1.0, -1.0, 1.0, 1.0])}


class Bridge:
    """
    Publishes the readings of a server, and sends them and the pose of the bone to a client.

    Parameters
    ----------
    node : Node
    stream : of the server
    topics : device -> topic; empty: all devices, each on /NAME/measured_cp
    frame_id : of the poses; empty: the frame in the name of the transform
    server : for the client; None: there is none
    registration : fully qualified name of the registration node
    model_axes : 'lps' or 'ras', of the model

    """

    def __init__(self, node: Node, stream: ToolStream, topics: Mapping[str, str] | None = None,
                 frame_id: str = '', server: PoseServer | None = None,
                 registration: str = '/registration', model_axes: str = 'lps') -> None:
        self._node, self._stream, self._server = node, stream, server
        self._topics, self._frame_id = dict(topics or {}), frame_id
        self._turn = TURNS[model_axes]
        self._publishers: dict[str, Publisher] = {}
        self._bone: tuple[str, float, Array] | None = None
        self._sent = 0.0
        self.counts: Counter[str] = Counter()
        if server is not None:
            self._status_topic = f'{registration}/status'
            node.create_subscription(PoseStamped, f'{registration}/bone_pose', self._on_bone,
                                     LATCHED)
            node.create_subscription(DiagnosticStatus, self._status_topic, self._on_status, LATCHED)

    def step(self) -> None:
        """Pass on what arrived; wait a moment if nothing did."""
        for reading in self._stream.receive(WAIT):
            if not self._topics or reading.device in self._topics:
                self._publish(reading)
        rclpy.spin_once(self._node, timeout_sec=0.0)
        now = time.monotonic()
        if self._server is not None and self._bone is not None and now - self._sent > REPEAT:
            self._sent = now
            # a node that ends at once withdraws nothing
            if self._node.count_publishers(self._status_topic):
                self._server.send(*self._bone)

    def summary(self) -> str:
        """Return the numbers of poses by device, and of those left out by cause."""
        lines = [f'{device}: {format_count(count, "pose")}' for device, count in
                 self.counts.items()]
        lines += [f'{device}: {count} left out, {cause.replace("_", " ")}'
                  for (device, cause), count in self._stream.dropped.items()]
        return '\n'.join(lines) or 'no transforms were received'

    def _publish(self, reading: ToolReading) -> None:
        tool, tracker = frames_of(reading.device)
        frame = self._frame_id or tracker
        if reading.device not in self._publishers:
            topic = self._topics.get(reading.device, f'/{tool}/measured_cp')
            self._publishers[reading.device] = self._node.create_publisher(
                PoseStamped, topic, QoSProfile(depth=100))
            print(f'{reading.device}: published on {topic} in frame {frame}', flush=True)
        self._publishers[reading.device].publish(
            pose_msg(reading.T_tracker_tool, frame, seconds_to_stamp(reading.stamp)))
        self.counts[reading.device] += 1
        if self._server is not None:
            self._server.send(reading.device, reading.stamp, reading.T_tracker_tool)

    def _on_bone(self, message: PoseStamped) -> None:
        stamp, T, frame = pose_from(message)
        words = ''.join(word.capitalize() for word in (frame or 'tracker').split('_'))
        device = f'BoneTo{words}'[:NAME_LENGTH]
        self._bone, self._sent = (device, stamp, T @ self._turn), 0.0

    def _on_status(self, status: DiagnosticStatus) -> None:
        """Stop sending a pose that was withdrawn; OpenIGTLink has no message for it."""
        if any(each.key == 'pose' and each.value == 'none' for each in status.values):
            self._bone = None


def run(args: argparse.Namespace) -> int:
    """Bridge until the process is interrupted."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with ExitStack() as stack:
            server = None
            if args.serve is not None:
                server = stack.enter_context(PoseServer(args.serve, args.interface))
            stream = stack.enter_context(ToolStream(args.host, args.port))
            bridge = Bridge(Node('igtl_bridge'), stream, topics_of(args.tool), args.frame_id,
                            server, args.node, args.model_axes)
            print(f'connecting to {args.host}:{args.port}', flush=True)
            try:
                while True:
                    bridge.step()
            except KeyboardInterrupt:
                print(bridge.summary(), file=sys.stderr)
    finally:
        rclpy.try_shutdown()
    return 0


def topics_of(options: list[str]) -> dict[str, str]:
    """Return device -> topic of options DEVICE=TOPIC or DEVICE."""
    topics = {}
    for option in options:
        device, separator, topic = option.partition('=')
        if not device or (separator and not topic.startswith('/')):
            raise InputError(f'--tool {option}: give DEVICE or DEVICE=/TOPIC, as in '
                             'StylusToTracker=/probe/measured_cp')
        # the header of a message has no room for more
        topics[device[:NAME_LENGTH]] = topic or f'/{frames_of(device)[0]}/measured_cp'
    return topics
