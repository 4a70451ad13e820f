# SPDX-License-Identifier: Apache-2.0
"""Run many jobs on all cores, with progress; a run can be interrupted and resumed."""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.execution.result_table import ResultTable, Row
from gsdf_registration.common.result import InputError

Job = TypeVar('Job')

# each job uses one core, so that one job per core can run
ONE_THREAD = {name: '1' for name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS',
                                     'NUMBA_NUM_THREADS')}


def run_all(jobs: Mapping[str, Job], work: Callable[[Job], Row], *, output: Path | None = None,
            about: Mapping[str, Any] | None = None, label: str = 'trials',
            workers: int | None = None) -> list[Row]:
    """
    Return the row of each job, in the order of the jobs.

    Rows are appended to ``output`` as they are computed; jobs that it contains are not run again.

    Parameters
    ----------
    jobs : by unique names; jobs and ``work`` are pickled
    work : a function of a module that returns a row: column -> str, number, bool or None; every
        row has the same columns
    output : table to write or to continue, see `ResultTable`; None: none
    about : what the rows depend on; an ``output`` with another ``about`` is rejected
    label : of the progress bar, which is shown if standard error is a terminal
    workers : number of processes; None: one per core

    Raises
    ------
    InputError
        If ``output`` cannot be continued, or from a job; the rows computed so far are kept.

    """
    table = ResultTable(output, about or {})
    left = {name: job for name, job in jobs.items() if name not in table.rows}
    with _progress(label, len(jobs), len(jobs) - len(left)) as advance:
        for name, row in _finished(left, work, workers or os.cpu_count() or 1):
            table.add(name, row)
            advance()
    return [table.rows[name] for name in jobs]


def _finished(jobs: Mapping[str, Job], work: Callable[[Job], Row],
              workers: int) -> Iterator[tuple[str, Row]]:
    """Yield name and row of each finished job; an early end terminates the processes."""
    # spawned: a fork would copy locks that threads of the parent hold
    context = multiprocessing.get_context('spawn')
    with _environment(ONE_THREAD):
        pool = ProcessPoolExecutor(min(workers, max(len(jobs), 1)), context, _start_worker)
        try:
            names = {pool.submit(work, job): name for name, job in jobs.items()}
            for done in as_completed(names):
                yield names[done], done.result()
        except BrokenProcessPool:
            raise InputError('a process died, perhaps because of too little memory; '
                             'run the same command again to continue') from None
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Ignore Ctrl-C, which the parent handles, and exit when the parent exits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def exit_with_parent() -> None:
        parent.join()
        os._exit(1)
    threading.Thread(target=exit_with_parent, daemon=True).start()


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
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


@contextmanager
def _progress(label: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar on a terminal; the yielded function advances it by one."""
    if not sys.stderr.isatty() or importlib.util.find_spec('rich') is None:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn
    columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=total, completed=done)
        yield lambda: bar.advance(task)
