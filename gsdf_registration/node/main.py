# SPDX-License-Identifier: Apache-2.0
"""The process of the node: one thread spins the node, the main thread waits for a signal."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import traceback
import warnings
from typing import TYPE_CHECKING, NoReturn

from gsdf_registration.node.memory import limit_memory

if TYPE_CHECKING:
    from rclpy.executors import Executor

    from gsdf_registration.node.node import RegistrationNode

SIGNALS = {signal.SIGINT, signal.SIGTERM}
SHUTDOWN_TIMEOUT = 0.8  # s; a computation that takes longer is abandoned


def main(args: list[str] | None = None) -> NoReturn:
    """
    Run the node until SIGINT or SIGTERM.

    Both signals are blocked before the slow imports and received by sigwait, so that no handler
    interrupts the code and a second signal has no effect.

    The exit status is 0 after a signal, 1 after an internal error at the start, and 2 if the
    arguments or parameters cannot be used.

    """
    limit_memory()
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    spinner = _Spinner(args)
    spinner.start()
    signal.sigwait(SIGNALS)
    status = spinner.stop()
    sys.stdout.flush()
    # exit at once: the teardown of the interpreter would take half a second
    os._exit(status)


class _Spinner(threading.Thread):
    """Creates the node and spins it until `stop`; an exception in a callback is logged."""

    def __init__(self, args: list[str] | None) -> None:
        super().__init__(name='executor', daemon=True)
        self._args = args
        self._executor: Executor | None = None
        self._node: RegistrationNode | None = None      # None while the node starts
        self._stopping = threading.Event()
        self._status = 1

    def run(self) -> None:
        try:
            self._status = self._spin()
        finally:
            os.kill(os.getpid(), signal.SIGTERM)    # end the sigwait of the main thread

    def _spin(self) -> int:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        from gsdf_registration.common.result import InputError
        from gsdf_registration.node.log_folder import choose_log_folder
        from gsdf_registration.node.node import RegistrationNode

        choose_log_folder()
        try:
            rclpy.init(args=self._args, signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:       # a parameter file or argument that ROS cannot parse
            return _fail(f'invalid ROS arguments: {error}')
        try:
            node = RegistrationNode()
        except InputError as error:
            return _fail(error.message)
        self._executor = executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.create_task(node.start)
        self._node = node
        gc.freeze()     # see `loading`: a full collection stops all threads
        while not self._stopping.is_set():
            try:
                executor.spin_once()
            # noqa: BLE001 - one message or request must not end the process
            except Exception as error:
                node.get_logger().error(f'internal error, please report it: '
                                        f'{type(error).__name__}: {error}')
                node.get_logger().debug(traceback.format_exc())
        return 0

    def stop(self) -> int:
        """Stop the node, or abandon it while it starts or computes; return the exit status."""
        self._stopping.set()
        node = self._node
        if node is not None and self._executor is not None:
            node.cancelled.set()
            self._executor.create_task(lambda: None)    # wakes the executor
        self.join(SHUTDOWN_TIMEOUT)
        if self.is_alive() or (node is not None and not node.finish(SHUTDOWN_TIMEOUT)):
            return 0    # starting or in a long computation: no data can be lost
        import rclpy
        if self._executor is not None:
            self._executor.shutdown(0.0)
        rclpy.try_shutdown()
        # tasks that have not begun, as `RegistrationNode.start` after a signal at once, end here
        warnings.filterwarnings('ignore', 'coroutine .* was never awaited', RuntimeWarning)
        # DDS announces the end of the node only once nothing refers to it any more
        self._node = self._executor = node = None
        gc.unfreeze()
        gc.collect()
        return self._status


def _fail(message: str) -> int:
    """Print in one line why the node cannot start; return the exit status."""
    print(f'registration_node: {" ".join(message.split())}', file=sys.stderr)
    return 2


if __name__ == '__main__':
    main()
