# SPDX-License-Identifier: Apache-2.0
"""The process of the node: one thread lives its life, the main thread waits for a signal."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from rclpy.executors import Executor

    from gsdf_registration.node.node import RegistrationNode

STOP = {signal.SIGINT, signal.SIGTERM}
GRACE = 0.8     # s; what still computes after that is left behind


def main(args: list[str] | None = None) -> NoReturn:
    """
    Run the node until SIGINT or SIGTERM.

    The signals are blocked before the slow imports and taken by sigwait: no handler interrupts
    anything, and one signal on the heels of another finds nothing to harm.

    The exit status is 0 after a signal, 1 after a failure of our own, and 2 when what was given
    cannot be used.

    """
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)
    life = _Life(args)
    life.start()
    signal.sigwait(STOP)
    status = life.end()
    sys.stdout.flush()
    # what is left behind ends here; else the interpreter would take half a second to fall apart
    os._exit(status)


class _Life(threading.Thread):
    """Makes the node and spins it until told to stop; a callback that fails ends the process."""

    def __init__(self, args: list[str] | None) -> None:
        super().__init__(name='executor', daemon=True)
        self._args = args
        self._executor: Executor | None = None
        self._node: RegistrationNode | None = None      # None: still starting, nothing to lose
        self._stopping = threading.Event()
        self._status = 1

    def run(self) -> None:
        try:
            self._status = self._live()
        finally:
            os.kill(os.getpid(), signal.SIGTERM)    # or the main thread would wait for ever

    def _live(self) -> int:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        from gsdf_registration.common.result import InputError
        from gsdf_registration.node.node import RegistrationNode

        try:
            rclpy.init(args=self._args, signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:       # what ROS says of a file or an argument it cannot read
            return _refuse(f'the arguments of ROS cannot be used: {error}')
        try:
            node = RegistrationNode()
        except InputError as error:
            return _refuse(error.message)
        self._executor = executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.create_task(node.start)
        self._node = node
        while not self._stopping.is_set():
            executor.spin_once()
        return 0

    def end(self) -> int:
        """Stop the node, or leave it behind if it starts or computes; return the exit status."""
        self._stopping.set()
        node = self._node
        if node is not None and self._executor is not None:
            node.cancelled.set()
            self._executor.create_task(lambda: None)    # so that it looks up
        self.join(GRACE)
        if self.is_alive() or (node is not None and not node.finish(GRACE)):
            return 0    # in the middle of a start or a long computation: nothing can be lost
        import rclpy
        if self._executor is not None:
            self._executor.shutdown(0.0)
        rclpy.try_shutdown()
        # others hear at once that we are gone only if nothing refers to the node any more
        self._node = self._executor = node = None
        gc.collect()
        return self._status


def _refuse(message: str) -> int:
    """Say in one line why there is no node; return the exit status."""
    print(f'registration_node: {" ".join(message.split())}', file=sys.stderr)
    return 2


if __name__ == '__main__':
    main()
