# SPDX-License-Identifier: Apache-2.0
"""Sends points to a node and hears what it makes of them, by one clock, for ``gsdf bench live``."""

from __future__ import annotations

import threading
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy

from benchmarks.live_figures import Heard, processor_seconds
from gsdf_registration.clients.operator import Operator
from gsdf_registration.common.rigid import Array
from gsdf_registration.node.qos import LATCHED
from msg_adapters import ros

FRAME = 'tracker'
SETTLE = 0.5        # s for what is under way to arrive
COUNTED = 3.0       # s for the status to tell of the last point


class Meter:
    """
    A tracker and a viewer in one.

    Parameters
    ----------
    operator : talks to the node
    process : id of the node's process
    name : of the node
    topic : on which it expects points

    """

    def __init__(self, operator: Operator, process: int, name: str = '/registration',
                 topic: str = '/probe/tip') -> None:
        self._operator, self._process = operator, process
        # as most trackers publish; nothing waits here long enough to be dropped
        best_effort = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._points = operator.node.create_publisher(PointStamped, topic, best_effort)
        self._heard = Heard()
        self._counts = {'received': 0, 'kept': 0}
        operator.node.create_subscription(PoseWithCovarianceStamped, f'{name}/live_pose',
                                          self._on_pose, best_effort)
        operator.node.create_subscription(DiagnosticStatus, f'{name}/status', self._on_status,
                                          LATCHED)

    def await_listener(self, position: Array) -> None:
        """Send a point again and again until it comes through, then have the node forget it."""
        def through() -> bool:
            self._send(position)
            return self._counts['received'] > 0
        self._operator.spin_until(through, 'no point comes through')
        self._let_arrive()
        self._operator.ask('clear')
        self._let_arrive()

    def run(self, positions: Array, rate: float) -> Heard:
        """
        Send ``positions`` (n, 3), m, at ``rate``, Hz, stamped as they go; return what came.

        Where the tip is depends on the time alone: what we are too late for is left out.
        """
        self._heard = heard = Heard()
        before = dict(self._counts)
        # what comes in is heard while we send
        sending, patience = threading.Event(), self._operator.patience
        self._operator.patience = np.inf
        listener = threading.Thread(target=self._operator.spin_until, args=(sending.is_set, ''))
        listener.start()
        try:
            cpu, start = processor_seconds(self._process), time.perf_counter()
            while (number := int((time.perf_counter() - start) * rate)) < len(positions):
                heard.sent.append(self._send(positions[number]))
                # if this one was late, not the next one on its heels: that would be a fast tip
                due = max((number + 1.0) / rate, time.perf_counter() - start + 0.5 / rate)
                time.sleep(max(0.0, start + due - time.perf_counter()))
            heard.cpu = processor_seconds(self._process) - cpu
        finally:
            sending.set()
            listener.join()
            self._operator.patience = patience
        self._let_arrive()
        deadline = time.monotonic() + COUNTED
        self._operator.spin_until(
            lambda: self._counts['received'] - before['received'] >= len(heard.sent)
            or time.monotonic() > deadline, '')
        heard.received, heard.kept = (self._counts[key] - before[key]
                                      for key in ('received', 'kept'))
        return heard

    def _let_arrive(self) -> None:
        end = time.monotonic() + SETTLE
        self._operator.spin_until(lambda: time.monotonic() > end, '')

    def _send(self, position: Array) -> float:
        now = time.time()
        self._points.publish(ros.point_msg(position, FRAME, ros.seconds_to_stamp(now)))
        return now

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        arrival = time.time()
        pose = PoseStamped(header=message.header, pose=message.pose.pose)
        stamp, self._heard.pose, _ = ros.pose_from(pose)
        self._heard.poses.append((arrival, stamp))

    def _on_status(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self._counts = {key: int(values[key]) for key in self._counts}
        if self._heard.ready is None and values['state'] == 'ready':
            self._heard.ready = time.time()
