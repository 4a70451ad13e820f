# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks archive``: how fast an archive of recordings is registered."""

from __future__ import annotations

import argparse
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks.options import SHIPPED, add_seed_option, print_table
from gsdf_registration.common.command_line import counting_bar, example, positive_number
from gsdf_registration.common.result import InputError

COLUMNS = ('run', 'results', 'time s', 'results/s', 'faster', 'CPU ms', 'MB')
WIDTHS = (34, 9, 9, 11, 8, 8, 7)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'archive', help='measure how fast an archive is registered, here and on a Dask cluster',
        description='Simulate an archive of recordings with landmarks, one of 20 cut and one '
        'empty. Register it with 1 and 2 processes and on a local Dask cluster of 2 workers, '
        'compare the tables, and continue a run that is complete. Then register empty recordings '
        'only, which measures what is done for each recording apart from the registration. CPU '
        'ms: of all processes of the command, for each result, which other programs on the machine '
        'change less than the time; without the workers of the cluster. MB: largest memory of the '
        'command itself. Needs the extra "dask".',
        **example('python -m benchmarks archive --bags 1000'))
    parser.add_argument('--bags', type=positive_number, default=1000, metavar='N',
                        help='number of recordings (default: 1000)')
    parser.add_argument('--empty', type=positive_number, default=5000, metavar='N',
                        help='number of empty recordings (default: 5000)')
    add_seed_option(parser, 'seed of the recordings')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, register, and print a table."""
    from benchmarks.archive.simulated import simulate_archive
    from gsdf_registration.field.model import find_model
    from msg_adapters.extras import needed
    needed('distributed', 'dask', 'Dask clusters')
    model = find_model(SHIPPED)
    with tempfile.TemporaryDirectory(prefix='gsdf_archive_') as temporary:
        folder = Path(temporary)
        started = perf_counter()
        with counting_bar('simulated', args.bags) as advance:
            cases = simulate_archive(folder, model, args.bags, args.seed, advance)
        print(f'{args.bags} recordings simulated in {perf_counter() - started:.0f} s\n')
        empty = _empty_recordings(folder / 'empty', args.empty)
        what = ['--cases', str(cases), '--model', str(model)]
        print_table([COLUMNS], WIDTHS)
        first = _measure('1 process', what, folder / 'one', args.bags)
        _measure('2 processes', [*what, '--jobs', '2'], folder / 'two', args.bags, first)
        with _cluster(2) as address:
            on_cluster = ['--scheduler', address]
            _measure('Dask, 2 workers', [*what, *on_cluster], folder / 'dask', args.bags, first)
            _measure('complete run, continued', what, folder / 'one', args.bags)
            nothing = [str(empty), '--model', str(model)]
            _measure('empty recordings, 2 processes', [*nothing, '--jobs', '2'],
                     folder / 'empty_two', args.empty)
            _measure('empty recordings, Dask', [*nothing, *on_cluster], folder / 'empty_dask',
                     args.empty)
        for other in ('two', 'dask'):
            _gsdf('compare', str(folder / 'one'), str(folder / other), '--limit', '0')
        print('\nthe tables are the same, to the bit')
    return 0


def _measure(name: str, what: list[str], output: Path, count: int,
             reference: float | None = None) -> float:
    """Run the command, print a row, and return the time, s."""
    started = perf_counter()
    cpu, memory = _gsdf('replay', *what, '--output', str(output))
    seconds = perf_counter() - started
    print_table([(name, str(count), f'{seconds:.1f}', f'{count / seconds:.1f}',
                  f'{reference / seconds:.2f}' if reference else '', f'{1e3 * cpu / count:.0f}',
                  f'{memory:.0f}')], WIDTHS)
    sys.stdout.flush()
    return seconds


def _gsdf(*words: str) -> tuple[float, float]:
    """Run the command; return its CPU time, s, and memory, MB; raise `InputError` if it fails."""
    process = subprocess.Popen([sys.executable, '-m', 'gsdf_registration', *words],
                               stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    # empty recordings are unreadable input, 2; a difference is 1 and so is an interruption
    if process.returncode not in ((0, 2) if words[0] == 'replay' else (0,)):
        raise InputError(f'gsdf {" ".join(words)} ended with the status {process.returncode}')
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0


@contextmanager
def _cluster(workers: int) -> Iterator[str]:
    """Run a Dask cluster on this machine; yield the address of its scheduler."""
    from distributed import LocalCluster
    logging.getLogger('distributed').setLevel(logging.ERROR)
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=':0') as cluster:
        yield str(cluster.scheduler_address)


def _empty_recordings(folder: Path, count: int) -> Path:
    """Write empty recordings of different content, and return their folder."""
    folder.mkdir()
    for number in range(count):
        (folder / f'{number:06d}.mcap').write_text(str(number))
    return folder
