# SPDX-License-Identifier: Apache-2.0
"""Run jobs on an existing Dask cluster; needs dask.distributed (extra "dask")."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable, Iterator
from itertools import islice
from typing import Any, TypeVar

from gsdf_registration import __version__
from gsdf_registration.common.process_pool import Died
from gsdf_registration.common.result import InputError

Job = TypeVar('Job')
Answer = TypeVar('Answer')

CONNECT, WORKERS = 10.0, 60.0       # s to wait for the scheduler, and for the first worker
AHEAD = 4           # jobs at the scheduler for each thread of the workers; the others wait here
COUNT_AGAIN = 100   # jobs after which the threads are counted again: a cluster may grow


def run_on_cluster(address: str, work: Callable[[Job], Answer], jobs: Iterable[Job]
                   ) -> Generator[tuple[int, Answer | Died], None, None]:
    """
    Yield the number and the answer of each job as it is finished.

    Jobs whose worker died are run again one by one, which shows the one that ends its worker.

    Parameters
    ----------
    address : of the scheduler, as tcp://HOST:8786
    work : a function of a module that the workers have; jobs and answers are pickled
    jobs : are taken from the iterable as workers become free

    Raises
    ------
    InputError
        If there is no such cluster, it has no workers, these do not have this package, or the
        connection is lost.

    """
    from msg_adapters.extras import needed
    distributed = needed('distributed', 'dask', 'Dask clusters')
    logging.getLogger('distributed').setLevel(logging.CRITICAL)     # errors are raised
    try:
        client = distributed.Client(address, timeout=CONNECT)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f'--scheduler {address}: there is no Dask scheduler: '
                         f'{" ".join(str(error).split()) or type(error).__name__}') from None
    with client:
        _check_workers(client, address)
        numbered, died = enumerate(jobs), list[tuple[int, Job]]()
        yield from _run(distributed, client, work, numbered, died, 0)
        for item in died:
            guilty = list[tuple[int, Job]]()
            yield from _run(distributed, client, work, iter([item]), guilty, 1)
            if guilty:
                yield item[0], Died()


def _check_workers(client: Any, address: str) -> None:
    """Raise `InputError` unless all workers have this version of the package."""
    try:
        client.wait_for_workers(1, timeout=WORKERS)
    except TimeoutError:
        raise InputError(f'--scheduler {address}: the cluster has no workers; start them with '
                         f'`dask worker {address}`') from None
    try:
        versions = set(client.run(version_of_package).values())
    except ImportError as error:
        raise InputError(f'--scheduler {address}: the workers do not have gsdf_registration '
                         f'{__version__}: {error}') from None
    if versions != {__version__}:
        raise InputError(f'--scheduler {address}: the workers have gsdf_registration '
                         f'{", ".join(sorted(versions))}, and this is {__version__}; install the '
                         'same version')


def version_of_package() -> str:
    """Return the version of this package; called on the workers."""
    return __version__


def _run(distributed: Any, client: Any, work: Callable[[Job], Answer],
         jobs: Iterator[tuple[int, Job]], died: list[tuple[int, Job]], most: int
         ) -> Generator[tuple[int, Answer], None, None]:
    """Yield answers, and append the jobs whose worker died; ``most`` at once, 0: by the threads."""
    running: dict[str, tuple[int, Job]] = {}
    finished = distributed.as_completed()
    for count in range(2**63):
        if count % COUNT_AGAIN == 0:
            window = most or AHEAD * max(sum(client.nthreads().values()), 1)
        for item in islice(jobs, max(window - len(running), 0)):
            # pure: equal jobs are run again, and not found by a hash
            future = client.submit(work, item[1], pure=False)
            running[future.key] = item
            finished.add(future)
        if not running:
            return
        future = next(finished)
        item = running.pop(future.key)
        try:
            answer = future.result()
        except distributed.KilledWorker:
            died.append(item)
            continue
        except (distributed.CancelledError, OSError) as error:
            raise InputError('the connection to the Dask scheduler was lost '
                             f'({type(error).__name__}); run the same command again to '
                             'continue') from None
        yield item[0], answer
