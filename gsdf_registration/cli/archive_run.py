# SPDX-License-Identifier: Apache-2.0
"""Register an archive of recordings into a folder of results; a run can be continued."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

from gsdf_registration.cli import archive_table as table
from gsdf_registration.cli import inputs, outputs
from gsdf_registration.cli.archive_cluster import run_on_cluster
from gsdf_registration.cli.archive_jobs import Job, jobs_of, key_of
from gsdf_registration.cli.archive_row import (
    CRASHED,
    Row,
    compute_row,
    crashed_row,
    hash_of_bag,
    moved_row,
)
from gsdf_registration.common.command_line import counting_bar
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.process_pool import Died, run_processes, threads_each
from gsdf_registration.common.result import InputError, Reason

DIED = ('the process that registered it ended without an answer: too little memory, or an error '
        'that ends the program')
UNREADABLE = (Reason.BAD_INPUT.value, CRASHED)      # reasons that say nothing about the bone


def run(args: argparse.Namespace) -> int:
    """Register the recordings that are not in the folder yet; write tables and page."""
    if args.report:
        raise InputError(f'--report {args.report}: with --output each report gets its own name; '
                         'give --report without a name')
    if args.scheduler and args.jobs:
        raise InputError('--jobs is for this machine, --scheduler for a cluster; give one of them')
    outputs.require_report(args.report)
    workers = args.jobs or 1
    jobs = jobs_of(args, 1 if args.scheduler else threads_each(workers))
    if not table.has_pyarrow():
        print(f'note: {table.PARQUET} is not written: it needs pyarrow, which is not installed: '
              "pip install 'gsdf_registration[dask]'", file=sys.stderr)
    _prepare(jobs, local=not args.scheduler)
    archive = _Archive(Path(args.output), jobs)
    try:
        with counting_bar('recordings', len(jobs)) as advance:
            archive.compute(args.scheduler, workers, advance)
    except BaseException:       # as after Ctrl-C: the rows so far
        if archive.computed:
            archive.write()
        raise
    counts = archive.write()
    print(_summary(counts, archive.known, args.output))
    return max(_status(reason) for reason in counts)


def _prepare(jobs: list[Job], local: bool) -> None:
    """Compile the kernels, and cache the model if it is the same for all jobs."""
    from gsdf_registration.common.config import Config
    config = Config.from_flat({**jobs[0].options.config, 'model.path': jobs[0].options.args.model})
    if local:
        inputs.prepare_kernels(config)
    if len({job.options.args.model for job in jobs}) == 1:
        inputs.timed_field(config)


class _Archive:
    """The jobs of a run, and the places of their rows in the journal."""

    def __init__(self, folder: Path, jobs: list[Job]) -> None:
        self.known = self.computed = 0      # jobs answered by an earlier run, and by this one
        self._folder, self._jobs = folder, jobs
        self._journal = table.Journal(folder)
        self._places: list[int | None] = [None] * len(jobs)

    def compute(self, scheduler: str | None, workers: int, advance: Callable[[], None]) -> None:
        """Compute the missing rows, here or on a cluster; ``advance`` is called for each row."""
        numbers = list[int]()       # of the jobs that are computed
        missing = self._missing(numbers, advance)
        answers = (run_on_cluster(scheduler, compute_row, missing) if scheduler else
                   run_processes(compute_row, missing, workers))
        with closing(answers):
            for index, answer in answers:
                job = self._jobs[numbers[index]]
                key, row = _died(job) if isinstance(answer, Died) else answer
                self._places[numbers[index]] = self._journal.add(key, row)
                self.computed += 1
                advance()

    def write(self) -> Counter[str]:
        """Write tables and page; return the number of rows of each reason."""
        from gsdf_registration.visualization.archive_page import write_page
        folder = self._folder
        table.write_csv(folder / table.CSV, self._rows())
        if table.has_pyarrow():
            table.write_parquet(folder / table.PARQUET, self._rows())
        options = {job.options.settings_sha256: job.options for job in self._jobs}
        outputs.write_json(str(folder / table.SETTINGS), {
            key: {'setting': each.setting, 'config': each.config}
            for key, each in options.items()})
        missing = self._places.count(None)
        write_page(folder / table.PAGE, self._rows(), missing,
                   [name for name in (table.CSV, table.PARQUET) if (folder / name).is_file()])
        counts = Counter(str(row['reason']) for row in self._rows())
        self._journal.close()
        return counts

    def _missing(self, numbers: list[int], advance: Callable[[], None]) -> Iterator[Job]:
        """Yield the jobs that no earlier run answered, and append their numbers."""
        for number, job in enumerate(self._jobs):
            place = None if self._journal.is_empty else self._earlier(job)
            if place is None:
                numbers.append(number)
                yield job
                continue
            self._places[number] = place
            self.known += 1
            advance()

    def _earlier(self, job: Job) -> int | None:
        """Return the place of the row if an earlier run answered a recording of this content."""
        key = key_of(job, hash_of_bag(job.path))
        place = self._journal.earlier(key, job.bag)
        if place is None:
            return None
        row = self._journal.row(place)
        if not all((self._folder / row[name]).is_file() for name in ('result', 'report')
                   if row[name]):
            return None
        moved = moved_row(row, job)
        return place if moved == row else self._journal.add(key, moved)

    def _rows(self) -> Iterator[Row]:
        """Yield the rows in the order of the jobs."""
        return (self._journal.row(place) for place in self._places if place is not None)


def _died(job: Job) -> tuple[str, Row]:
    """Return key and row of a job whose process died."""
    bag_sha256 = hash_of_bag(job.path)
    return key_of(job, bag_sha256), {**crashed_row(job, DIED), 'bag_sha256': bag_sha256}


def _status(reason: str) -> int:
    """Return the exit code of a reason."""
    return 0 if reason == Reason.CONVERGED.value else 2 if reason in UNREADABLE else 1


def _summary(counts: Counter[str], known: int, folder: str) -> str:
    reasons = sorted(counts, key=lambda reason: (_status(reason), -counts[reason], reason))
    outcomes = ', '.join(f'{counts[reason]} '
                         + ('registered' if _status(reason) == 0 else reason)
                         for reason in reasons)
    before = f', {known} of them from an earlier run' if known else ''
    return '\n'.join([
        f'{format_count(sum(counts.values()), "result")}{before}: {outcomes}',
        f'  table          {Path(folder, table.CSV)}',
        f'  page           {Path(folder, table.PAGE)}'])
