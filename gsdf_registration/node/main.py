# SPDX-License-Identifier: Apache-2.0
"""The process of the node: one thread spins, the main thread waits for a signal and ends it all."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rclpy.executors import Executor

STOP = {signal.SIGINT, signal.SIGTERM}
GRACE = 0.8     # s; what still computes after that is left behind


def main(args: list[str] | None = None) -> int:
    """
    Run the node until SIGINT or SIGTERM.

    The signals are blocked before the slow imports and taken by sigwait: no handler interrupts
    anything, and one signal on the heels of another finds nothing to harm.

    Returns
    -------
    int
        0 after a signal, 1 after a failure of our own, 2 when the parameters cannot be used.

    """
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    from gsdf_registration.node.node import RegistrationNode
    from gsdf_registration.result import InputError

    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = RegistrationNode()
    except InputError as error:
        print(f'registration_node: {error.message}', file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.create_task(node.start)
    spinning = _Spinning(executor)
    spinning.start()
    signal.sigwait(STOP)
    spinning.stopping = True
    executor.create_task(lambda: None)      # so that it looks up
    node.cancelled.set()
    spinning.join(GRACE)
    if spinning.is_alive() or not node.finish(GRACE):
        os._exit(0)     # in the middle of a long computation that has nothing to lose
    rclpy.try_shutdown()
    return 1 if spinning.failed else 0


class _Spinning(threading.Thread):
    """Spins an executor until told to stop; a callback that fails ends the process."""

    def __init__(self, executor: Executor) -> None:
        super().__init__(name='executor', daemon=True)
        self.stopping = False
        self.failed = True
        self._executor = executor

    def run(self) -> None:
        try:
            while not self.stopping:
                self._executor.spin_once()
            self.failed = False
        finally:
            os.kill(os.getpid(), signal.SIGTERM)


if __name__ == '__main__':
    sys.exit(main())
