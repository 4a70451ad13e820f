# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks guided``: number of points needed with guidance and at random."""

from __future__ import annotations

import argparse
from functools import partial
from typing import TYPE_CHECKING, Any

from benchmarks.options import (
    add_bones_option,
    add_seed_option,
    add_table_options,
    bones,
    print_table,
    run_table,
    single_threaded,
)
from gsdf_registration.common.command_line import example, number, positive_number
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from benchmarks.execution.result_table import Row

WIDTHS = (32, 6, 8, 8, 7, 17, 13, 8, 8, 7, 8, 8, 8, 7)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'guided',
        help='compare the number of points needed with guidance and at random',
        description='Simulate short strokes on a bone and register after each. A stroke is over '
        'the place that the guidance proposes, or over a random place of the same exposed area. '
        'The tables show the number of points until the error is within the limit: the predicted '
        'error (mean over runs; a run that never reaches the limit counts with all its points), '
        'the predicted error without an alternative pose (where an operator would stop), and the '
        'true error (RMS over runs). Both strategies begin with the same two strokes of 60 points, '
        'which count. Runs already in FILE are not repeated.',
        **example('python -m benchmarks guided --bones ~/bones -o guided.tsv --plot guided.html'))
    add_bones_option(parser)
    parser.add_argument('--runs', type=positive_number, default=120, metavar='N',
                        help='runs per strategy, over all bones and regions (default: 120)')
    add_seed_option(parser, 'seed of the first runs')
    parser.add_argument('--strokes', type=positive_number, default=22, metavar='N',
                        help='strokes after the first two (default: 22)')
    parser.add_argument('--points', type=positive_number, default=30, metavar='N',
                        help='points per stroke, 0.34 mm apart (default: 30)')
    parser.add_argument('--limit', type=number, default=1.0, metavar='MM',
                        help='error to reach (default: 1.0)')
    add_table_options(parser, 'run')
    parser.add_argument('--plot', metavar='OUT.html', help='plot the error against the number of '
                        'points (needs the extra "report")')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the simulations and print the tables."""
    from benchmarks.guided.runs import runs_of, simulate_run
    from benchmarks.guided.tables import page
    from benchmarks.protocol.cases import find_cases
    from msg_adapters.files import write_atomically

    if not args.limit > 0.0:
        raise InputError('--limit must be more than 0')
    if args.plot:
        from benchmarks.require_plotly import require_plotly
        require_plotly()
    cases = find_cases(bones(args.bones))
    config = single_threaded(args)
    runs = runs_of(cases, args.runs, args.seed, args.strokes, args.points, 1e-3 * args.limit)
    rows = run_table(args, cases, config, {run.name: run for run in runs},
                     partial(simulate_run, config=config), 'runs', strokes=args.strokes,
                     points=args.points, limit=args.limit)
    show(rows, args.limit)
    if args.plot:
        write_atomically(args.plot, page(rows, 1e-3 * args.limit))
    return 0


def show(rows: list[Row], limit: float) -> None:
    """Print the table of each goal; ``limit`` in mm."""
    from benchmarks.guided.runs import GOALS
    from benchmarks.guided.tables import COLUMNS, table
    for goal, where in GOALS.items():
        print(f'points until the error (RMS) {where} is {limit:g} mm:\n'
              'predicted (mean; runs that needed fewer, as many, more points with guidance; RMS '
              'of the true error then, mm),\npredicted without an alternative pose (mean; runs '
              'that never reached it), and true (RMS over runs)\n')
        print_table([COLUMNS, *table(rows, goal, 1e-3 * limit)], WIDTHS)
        print()
