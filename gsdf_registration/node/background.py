# SPDX-License-Identifier: Apache-2.0
"""A background thread for long jobs, so that the executor keeps receiving points meanwhile."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.executors import Executor
from rclpy.task import Future

Result = TypeVar('Result')


class BackgroundThread:
    """
    Runs one job at a time outside the executor.

    One thread only: two parallel numba kernels at the same time abort the process under the default
    threading layer of numba.
    """

    def __init__(self) -> None:
        self._pool = concurrent.futures.ThreadPoolExecutor(max_workers=1,
                                                           thread_name_prefix='background')
        self._job: concurrent.futures.Future[Any] | None = None

    @property
    def busy(self) -> bool:
        """Whether a job runs."""
        return self._job is not None and not self._job.done()

    async def run(self, executor: Executor, job: Callable[[], Result]) -> Result:
        """
        Return what ``job`` returns, or raise what it raises.

        To be awaited in a callback of ``executor``, which serves other callbacks meanwhile.
        """
        running = self._job = self._pool.submit(job)
        done: Future = Future(executor=executor)
        # The callback itself does nothing, but scheduling it wakes the executor, which then resumes
        # this coroutine.
        done.add_done_callback(lambda _: None)
        running.add_done_callback(lambda _: done.set_result(None))
        await done
        return running.result()

    def shutdown(self, timeout: float) -> bool:
        """Accept no more jobs; return whether the running one ended within ``timeout`` seconds."""
        self._pool.shutdown(wait=False)
        return self._job is None or not concurrent.futures.wait([self._job], timeout).not_done
