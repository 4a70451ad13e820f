# SPDX-License-Identifier: Apache-2.0
"""Run many jobs in other processes; a process that dies ends one job, not the others."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from typing import TypeVar

Job = TypeVar('Job')
Answer = TypeVar('Answer')

# each job uses one core, so that one job per core can run
ONE_THREAD = {name: '1' for name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS',
                                     'NUMBA_NUM_THREADS')}
AHEAD = 2       # jobs submitted for each process: the one that it runs, and the next one


class Died:
    """In place of the answer of a job: its process ended without one."""


def run_processes(work: Callable[[Job], Answer], jobs: Iterable[Job], workers: int
                  ) -> Generator[tuple[int, Answer | Died], None, None]:
    """
    Yield the number and the answer of each job as it is finished.

    When a process dies, the jobs that were submitted are run again one by one, which shows the job
    that ends its process.  An early end of the iteration terminates the processes.

    Parameters
    ----------
    work : a function of a module; jobs and answers are pickled
    jobs : are taken from the iterable as processes become free
    workers : number of processes

    """
    numbered = enumerate(jobs)
    with environment(ONE_THREAD):
        while True:
            suspects = yield from _run_pool(work, numbered, workers, AHEAD * workers)
            if not suspects:
                return
            one_by_one = iter(suspects)
            while guilty := (yield from _run_pool(work, one_by_one, 1, 1)):
                yield guilty[0][0], Died()


def _run_pool(work: Callable[[Job], Answer], jobs: Iterator[tuple[int, Job]], workers: int,
              most: int) -> Generator[tuple[int, Answer], None, list[tuple[int, Job]]]:
    """Yield answers; return the jobs without one if a process died, else an empty list."""
    # spawned: a fork would copy locks that threads of the parent hold
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context('spawn'), start_worker)
    running: dict[Future[Answer], tuple[int, Job]] = {}
    submitted: list[tuple[int, Job]] = []       # not accepted yet
    try:
        while True:
            for item in islice(jobs, most - len(running)):
                submitted = [item]
                running[pool.submit(work, item[1])] = item
                submitted = []
            if not running:
                return []
            done = wait(running, return_when=FIRST_COMPLETED)[0]
            for future in sorted(done, key=lambda each: running[each][0]):
                answer = future.result()
                yield running.pop(future)[0], answer
    except BrokenProcessPool:
        return sorted([*running.values(), *submitted], key=lambda item: item[0])
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def threads_each(workers: int) -> int:
    """Return how many threads each of some processes may use, so that all use every core once."""
    return max((os.cpu_count() or 1) // workers, 1)


def start_worker() -> None:
    """Ignore Ctrl-C, which the parent handles, and exit when the parent exits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def exit_with_parent() -> None:
        parent.join()
        os._exit(1)
    threading.Thread(target=exit_with_parent, daemon=True).start()


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables in a block; processes started in it inherit them."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
