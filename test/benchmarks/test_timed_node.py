# SPDX-License-Identifier: Apache-2.0
"""Test that pauses of an executor are recorded."""

from __future__ import annotations

import io
import time

import pytest


def test_a_callback_that_blocks_is_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    rclpy = pytest.importorskip('rclpy')
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from benchmarks.start.timed_node import add_timer
    monkeypatch.setattr(Node, '__init__', Node.__init__)    # restored after the test
    times, context = io.StringIO(), rclpy.Context()
    context.init()
    try:
        add_timer(times)
        node = Node('timed', context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        blocked = node.create_timer(0.001, lambda: (blocked.cancel(), time.sleep(0.1)))
        while times.getvalue().count('\n') < 10:
            executor.spin_once(timeout_sec=1.0)
        node.destroy_node()
    finally:
        context.shutdown()
    assert max(float(line) for line in times.getvalue().split()) >= 0.09
