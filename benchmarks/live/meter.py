# SPDX-License-Identifier: Apache-2.0
"""Send points to a node and receive its live pose and status, timed by one clock."""

from __future__ import annotations

import threading
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy

from benchmarks.live.figures import Measurement, processor_seconds
from gsdf_registration.clients.operator import LATCHED, Operator
from gsdf_registration.common.rigid import Array
from msg_adapters import ros

FRAME = 'tracker'
TRANSIT = 0.5       # s, for messages in transit to arrive
STATUS_DELAY = 3.0  # s, until the status has counted the last point


class Meter:
    """
    A tracker and a viewer in one process.

    Parameters
    ----------
    operator : client of the node
    process : process id of the node
    name : of the node
    topic : of the points

    """

    def __init__(self, operator: Operator, process: int, name: str = '/registration',
                 topic: str = '/probe/tip') -> None:
        self._operator, self._process = operator, process
        # as most trackers publish; the queue is deep enough to drop nothing
        best_effort = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._points = operator.node.create_publisher(PointStamped, topic, best_effort)
        self._measured = Measurement()
        self._counts = {'received': 0, 'kept': 0}
        operator.node.create_subscription(PoseWithCovarianceStamped, f'{name}/live_pose',
                                          self._on_pose, best_effort)
        operator.node.create_subscription(DiagnosticStatus, f'{name}/status', self._on_status,
                                          LATCHED)

    def await_subscriber(self, position: Array) -> None:
        """Send a point repeatedly until the node receives it, then clear the session."""
        def received() -> bool:
            self._send(position)
            return self._counts['received'] > 0
        self._operator.spin_until(received, 'the node did not receive a point')
        self._wait_for_transit()
        self._operator.ask('clear')
        self._wait_for_transit()

    def run(self, positions: Array, rate: float) -> Measurement:
        """
        Send ``positions`` (n, 3), m, at ``rate``, Hz, with the current time as stamp.

        The position of the tip depends on the time only: a position whose time has passed is
        skipped.
        """
        self._measured = measured = Measurement()
        before = dict(self._counts)
        # messages are received while points are sent
        finished, patience = threading.Event(), self._operator.patience
        self._operator.patience = np.inf
        receiver = threading.Thread(target=self._operator.spin_until, args=(finished.is_set, ''))
        receiver.start()
        try:
            cpu, start = processor_seconds(self._process), time.perf_counter()
            while (number := int((time.perf_counter() - start) * rate)) < len(positions):
                measured.sent.append(self._send(positions[number]))
                # after a late point, keep a distance to the next: the tip would appear too fast
                due = max((number + 1.0) / rate, time.perf_counter() - start + 0.5 / rate)
                time.sleep(max(0.0, start + due - time.perf_counter()))
            measured.cpu = processor_seconds(self._process) - cpu
        finally:
            finished.set()
            receiver.join()
            self._operator.patience = patience
        self._wait_for_transit()
        deadline = time.monotonic() + STATUS_DELAY
        self._operator.spin_until(
            lambda: self._counts['received'] - before['received'] >= len(measured.sent)
            or time.monotonic() > deadline, '')
        measured.received, measured.kept = (
            self._counts[key] - before[key] for key in ('received', 'kept'))
        return measured

    def _wait_for_transit(self) -> None:
        end = time.monotonic() + TRANSIT
        self._operator.spin_until(lambda: time.monotonic() > end, '')

    def _send(self, position: Array) -> float:
        now = time.time()
        self._points.publish(ros.point_msg(position, FRAME, ros.seconds_to_stamp(now)))
        return now

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        arrival = time.time()
        pose = PoseStamped(header=message.header, pose=message.pose.pose)
        stamp, self._measured.pose, _ = ros.pose_from(pose)
        self._measured.poses.append((arrival, stamp))

    def _on_status(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self._counts = {key: int(values[key]) for key in self._counts}
        if self._measured.ready is None and values['state'] == 'ready':
            self._measured.ready = time.time()
