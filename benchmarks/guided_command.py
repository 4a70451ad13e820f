# SPDX-License-Identifier: Apache-2.0
"""``gsdf bench guided``: how many points are spared by touching where guidance says."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.bones import about, add_bones_option, bones
from gsdf_registration.cli.common import example, read_config
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from benchmarks.journal import Row

WIDTHS = (32, 6, 8, 8, 7, 17, 13, 8, 8, 7, 8, 8, 8, 7)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'guided',
        help='count the points that guidance spares',
        description='Collect points of a bone by short simulated strokes, each over the patch that '
        'guidance names or over a random place of the same wound, and register after each. Shown '
        'is how many points it takes until the error is within the limit: as predicted (mean over '
        'runs, a run that never gets there counted with all its points); as predicted, with no '
        'other pose that fits about as well (when an operator would stop); and in truth (RMS over '
        'runs). Both ways begin with the same two strokes of 60 points, which count. Runs '
        'already in FILE are not made again.',
        **example('gsdf bench guided --bones ~/bones -o guided.tsv --plot guided.html'))
    add_bones_option(parser)
    parser.add_argument('--runs', type=int, default=120, metavar='N',
                        help='of each way, over all bones and regions (default: 120)')
    parser.add_argument('--seed', type=int, default=0, help='of the first runs (default: 0)')
    parser.add_argument('--strokes', type=int, default=22, metavar='N',
                        help='after the first two (default: 22)')
    parser.add_argument('--points', type=int, default=30, metavar='N',
                        help='of a stroke, 0.34 mm apart (default: 30)')
    parser.add_argument('--limit', type=float, default=1.0, metavar='MM',
                        help='error to reach (default: 1.0)')
    parser.add_argument('-o', '--output', metavar='FILE.tsv',
                        help='write a row for each run, or go on where it ends')
    parser.add_argument('--plot', metavar='OUT.html', help='write the error against the points, '
                        'as curves (needs the extra "report")')
    parser.add_argument('--config', metavar='YAML',
                        help='settings, as in config/registration.yaml')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Make the runs, print the tables."""
    from benchmarks.cases import find_cases
    from benchmarks.guided import attempt, collections
    from benchmarks.guided_tables import page
    from benchmarks.runner import run_all
    from msg_adapters.files import write_atomically

    if args.seed < 0 or min(args.runs, args.strokes, args.points) < 1 or not args.limit > 0.0:
        raise InputError('--seed must not be negative; --runs, --strokes and --points must be at '
                         'least 1, --limit more than 0')
    if args.plot:
        from gsdf_registration.visualization import require_plotly
        require_plotly()
    cases = find_cases(bones(args.bones))
    config = read_config(args.config).replaced({'search.threads': 1})
    runs = collections(cases, args.runs, args.seed, args.strokes, args.points,
                       1e-3 * args.limit)
    rows = run_all({run.name: run for run in runs}, partial(attempt, config=config), label='runs',
                   output=Path(args.output) if args.output else None,
                   about={**about(cases, args.seed, config), 'strokes': args.strokes,
                          'points': args.points, 'limit': args.limit})
    show(rows, args.limit)
    if args.plot:
        write_atomically(args.plot, page(rows, 1e-3 * args.limit))
    return 0


def show(rows: list[Row], limit: float) -> None:
    """Print the table of each goal; ``limit`` in mm."""
    from benchmarks.guided import GOALS
    from benchmarks.guided_tables import COLUMNS, table
    for goal, where in GOALS.items():
        print(f'points until the error (RMS) {where} is {limit:g} mm: as predicted (mean; runs '
              'with fewer, as many,\nmore points guided; RMS of the true error then, mm), as '
              'predicted with no rival pose (mean; runs that never\ngot there), and in truth (RMS '
              'over runs)\n')
        for cells in [COLUMNS, *table(rows, goal, 1e-3 * limit)]:
            print(f'{cells[0]:<{WIDTHS[0]}}'
                  + ''.join(f'{cell:>{width}}' for cell, width in zip(cells[1:], WIDTHS[1:])))
        print()
