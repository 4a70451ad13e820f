# SPDX-License-Identifier: Apache-2.0
"""The simulated clock of a node: whether /clock arrives; invalid times on it are ignored."""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

PATIENCE = 2.0      # s for the first message on /clock


class SimClock:
    """
    Watches /clock, which rclpy receives if ``use_sim_time``.

    At a time below zero rclpy raises an exception that nothing catches.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._received = False
        self._since = time.monotonic()      # when ``use_sim_time`` was first seen to be set
        self._used = False
        source: Any = node._time_source     # rclpy has no public access to it
        self._set_time = source.clock_callback
        source.clock_callback = self._on_clock      # for a later change of use_sim_time
        if source._clock_sub is not None:
            source._clock_sub.callback = self._on_clock

    @property
    def problem(self) -> str:
        """Why the node has no time; empty if it has."""
        used = bool(self._node.get_parameter('use_sim_time').value)
        now = time.monotonic()
        if used and not self._used:
            self._since, self._received = now, False
        self._used = used
        if not used or self._received or now - self._since < PATIENCE:
            return ''
        return ('use_sim_time is true, but no time is received on /clock, so poses have no valid '
                'stamp: start the simulator, play the recording with --clock, or set use_sim_time '
                'to false')

    def _on_clock(self, message: Clock) -> None:
        if message.clock.sec < 0:
            self._node.get_logger().warning(
                f'/clock has a time below zero, {message.clock.sec} s; it is ignored',
                throttle_duration_sec=10.0)
            return
        self._received = True
        self._set_time(message)
