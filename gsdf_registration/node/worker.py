# SPDX-License-Identifier: Apache-2.0
"""One thread beside the executor for what takes long, so that points keep coming in meanwhile."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.executors import Executor
from rclpy.task import Future

Result = TypeVar('Result')


class Worker:
    """
    Runs one job at a time off the executor.

    A single thread: two parallel numba kernels at once abort the process under its default
    threading layer.
    """

    def __init__(self) -> None:
        self._pool = concurrent.futures.ThreadPoolExecutor(max_workers=1,
                                                           thread_name_prefix='worker')
        self._job: concurrent.futures.Future[Any] | None = None

    @property
    def busy(self) -> bool:
        """Whether a job runs."""
        return self._job is not None and not self._job.done()

    async def run(self, executor: Executor, job: Callable[[], Result]) -> Result:
        """
        Return what ``job`` returns, or raise what it raises.

        Awaited on ``executor``, which goes on.
        """
        running = self._job = self._pool.submit(job)
        done: Future = Future(executor=executor)
        # It does nothing, but that it is scheduled wakes the executor, which then resumes us.
        done.add_done_callback(lambda _: None)
        running.add_done_callback(lambda _: done.set_result(None))
        await done
        return running.result()

    def shutdown(self, timeout: float) -> bool:
        """Take no further jobs; tell whether the running one ended within ``timeout`` seconds."""
        self._pool.shutdown(wait=False)
        return self._job is None or not concurrent.futures.wait([self._job], timeout).not_done
