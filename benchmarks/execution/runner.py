# SPDX-License-Identifier: Apache-2.0
"""Run many jobs on all cores, with progress; a run can be interrupted and resumed."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.execution.result_table import ResultTable, Row
from gsdf_registration.common.command_line import counting_bar
from gsdf_registration.common.process_pool import Died, run_processes
from gsdf_registration.common.result import InputError

Job = TypeVar('Job')


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
    names = list(left)
    answers = run_processes(work, left.values(), workers or os.cpu_count() or 1)
    with counting_bar(label, len(jobs), len(jobs) - len(left)) as advance, closing(answers):
        for number, row in answers:
            if isinstance(row, Died):
                raise InputError('a process died, perhaps because of too little memory; '
                                 'run the same command again to continue')
            table.add(names[number], row)
            advance()
    return [table.rows[name] for name in jobs]
