# SPDX-License-Identifier: Apache-2.0
"""
A program that runs the registration node and records the pauses of its executor.

``python -m benchmarks.start.timed_node FILE --ros-args ...``: a timer of `PERIOD` runs in the
executor of the node. Each time between two calls of it is a line of FILE, in seconds: it is the
longest time that a service call or a message may have waited.
"""

from __future__ import annotations

import runpy
import sys
import time
from typing import Any, TextIO

from rclpy.node import Node

PERIOD = 0.005      # s


def add_timer(file: TextIO) -> None:
    """Add a timer to each node that is created, which writes the times between its calls."""
    create = Node.__init__

    def create_with_timer(self: Node, *args: Any, **kwargs: Any) -> None:
        create(self, *args, **kwargs)
        last = time.perf_counter()

        def tick() -> None:
            nonlocal last
            now = time.perf_counter()
            file.write(f'{now - last}\n')
            last = now
        self.create_timer(PERIOD, tick)
    Node.__init__ = create_with_timer   # type: ignore[method-assign]


if __name__ == '__main__':
    with open(sys.argv.pop(1), 'w', buffering=1) as times:
        add_timer(times)
        runpy.run_module('gsdf_registration.node.main', run_name='__main__')
