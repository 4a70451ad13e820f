# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks air``: how many ambiguous poses the path through the air decides."""

from __future__ import annotations

import argparse
from functools import partial
from typing import TYPE_CHECKING, Any

from benchmarks.options import (
    add_bones_option,
    add_seed_option,
    add_table_options,
    bones,
    run_table,
    single_threaded,
)
from gsdf_registration.common.command_line import example, positive_number

if TYPE_CHECKING:
    from benchmarks.execution.result_table import Row

# the choice between poses alone decides
ANY_ACCURACY = {'limits.max_error': 1.0}
NAMES = {'tip': 'tip', 'shaft': 'tip and shaft', 'faulty': 'faulty probe'}


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'air', help='count the ambiguous poses that the path of the probe through the air decides',
        description='Register few points on a small area, which several poses fit, without and '
        'with the places where the probe was in the air: the tip between the strokes, and also '
        'its shaft. A faulty probe has a tip that is 1 mm off, a shaft that is 3 degrees off, and '
        'wrong readings in the air. The predicted error is not limited, so that only the choice '
        'between the poses counts. Rows already in FILE are not computed again.',
        **example('python -m benchmarks air --bones ~/bones --trials 240 -o air.tsv'))
    add_bones_option(parser)
    parser.add_argument('--trials', type=positive_number, default=60, metavar='N',
                        help='number of trials (default: 60)')
    parser.add_argument('--limits', action='store_true',
                        help='limit the predicted error as usual')
    add_seed_option(parser, 'seed of the first trials')
    add_table_options(parser, 'trial')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the trials and print a table."""
    from itertools import count, islice

    from benchmarks.air.trial import SCENARIOS, AirTrial, run_trial, suits
    from benchmarks.protocol.cases import find_cases

    cases = find_cases(bones(args.bones))
    config = single_threaded(args)
    if not args.limits:
        config = config.replaced(ANY_ACCURACY)
    every = (AirTrial(case, scenario, seed) for seed in count(args.seed) for case in cases
             for scenario in SCENARIOS if suits(scenario, case.region))
    trials = {trial.name: trial for trial in islice(every, args.trials)}
    show(run_table(args, cases, config, trials, partial(run_trial, config=config)))
    return 0


def show(rows: list[Row]) -> None:
    """Print the table."""
    import numpy as np
    print(f'{"scenario":<12}{"trials":>7}{"ambiguous":>11}  {"evidence":<15}{"decided":>8}'
          f'{"right":>7}{"wrong":>7}{"other":>7}{"lost":>6}{"wrong before":>14}{"wrong now":>11}'
          f'{"more ms":>9}')
    for scenario in [*dict.fromkeys(str(row['scenario']) for row in rows), 'all']:
        chosen = [row for row in rows if scenario in (row['scenario'], 'all')]
        ambiguous = [row for row in chosen if row['none_reason'] == 'ambiguous']
        for kind, name in NAMES.items():
            decided = [row[f'{kind}_verdict'] for row in ambiguous
                       if row[f'{kind}_reason'] != 'ambiguous']
            lost = sum(row['none_verdict'] == 'right' != row[f'{kind}_verdict'] for row in chosen)
            wrong = [sum(row[f'{each}_verdict'] == 'wrong' for row in chosen)
                     for each in ('none', kind)]
            more = np.median([row[f'{kind}_seconds'] - row['none_seconds']
                              for row in ambiguous]) if ambiguous else 0.0
            print(f'{scenario:<12}{len(chosen):>7}{len(ambiguous):>11}  {name:<15}'
                  f'{len(decided):>8}{decided.count("right"):>7}{decided.count("wrong"):>7}'
                  f'{decided.count("refused"):>7}{lost:>6}{wrong[0]:>14}{wrong[1]:>11}'
                  f'{1e3 * more:>9.0f}')
