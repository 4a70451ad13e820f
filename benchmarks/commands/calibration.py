# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks calibration``: whether the stated errors are true."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from itertools import islice
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
from gsdf_registration.common.command_line import example, positive_number
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from benchmarks.execution.result_table import Row
    from benchmarks.protocol.trials import Trial

# with an exact model, with interference, and all that have an inexact one
EXACT = ('clean', 'sigma_0.15', 'uniform_50', 'mixed_40')


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'calibration',
        help='compare true with stated errors, on exact and inexact models',
        description='Solve from near the true pose, and compare the error of the pose with the '
        'stated covariance, and the error at places near the incision and over the bone with the '
        'stated RMS and 95 % bound. Rows already in FILE are not computed again. Imperfect models '
        'are made once, which takes some seconds each, and cached.',
        **example('python -m benchmarks calibration --bones ~/bones -o calibration.tsv'))
    add_bones_option(parser)
    parser.add_argument('--trials', type=positive_number, default=200, metavar='N',
                        help='number of trials of each scenario (default: 200)')
    parser.add_argument('--scenarios', metavar='NAME,...', default='',
                        help='scenarios of the trust benchmark; * matches any text (default: '
                        f'{", ".join(EXACT)} and those with an inexact model)')
    parser.add_argument('--peers', action='store_true',
                        help='test the accuracy that other libraries state instead; they are '
                        'installed in an environment of their own')
    add_seed_option(parser, 'seed of the first trials')
    add_table_options(parser, 'trial')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the trials and print the table."""
    from benchmarks.calibration.tables import (
        COLUMNS,
        COST_COLUMNS,
        COST_WIDTHS,
        WIDTHS,
        cost_table,
        peer_table,
        table,
    )
    from benchmarks.calibration.trial import run_trial
    from benchmarks.commands.trust import scenarios
    from benchmarks.protocol.cases import find_cases
    from benchmarks.protocol.trials import SCENARIOS, trials

    cases = find_cases(bones(args.bones))
    config = single_threaded(args)
    wanted = scenarios(args.scenarios) if args.scenarios else [
        each for each in SCENARIOS.values() if each.name in EXACT or each.real_model]
    wanted = [each for each in wanted if not each.wrong]
    selected = [trial for scenario in wanted
                for trial in islice(trials(cases, [scenario], args.seed), args.trials)]
    if not selected:
        raise InputError('none of these scenarios has a true pose; choose others')
    jobs, work = peer_jobs(selected) if args.peers else (
        {trial.name: trial for trial in selected},
        partial(run_trial, config=config))
    rows = run_table(args, cases, config, jobs, work)
    print('lost: in another minimum; near: the exposed area, far: the whole bone, RMS, mm; within '
          '95 %: places whose\nerror is within its stated bound; bound: Cramer-Rao, of an exact '
          'model; refused: well-posed\nproblems whose stated error is beyond the limit; not seen: '
          'by the most powerful test for the deviation,\nwhich knows all of it but its course, '
          'with 5 % of false alarms\n')
    if args.peers:
        print_table([COLUMNS, *peer_table(rows)], WIDTHS)
        return 0
    print_table([COLUMNS, *table(rows)], WIDTHS)
    print('\nwhat another stated covariance would cost, where an error of the model was found and '
          'where not\n')
    print_table([COST_COLUMNS, *cost_table(rows)], COST_WIDTHS)
    return 0


def peer_jobs(trials: list[Trial]) -> tuple[dict[str, Any], Callable[[Any], Row]]:
    """Return jobs and work of all peers; those that cannot be installed are named on stderr."""
    import sys

    from benchmarks.calibration.peers import run_peer
    from benchmarks.peers.catalogue import CURRENT, STATING
    from benchmarks.peers.environment import environment
    from gsdf_registration.field.cache import cache_directory

    installed, folder = environment(CURRENT), cache_directory() / 'benchmarks'
    folder.mkdir(parents=True, exist_ok=True)
    jobs = {}
    for name, peer in STATING.items():
        if peer.library in installed.missing:
            print(f'{name}: {installed.missing[peer.library]}', file=sys.stderr)
            continue
        # one model after the other: a process is prepared for one
        for trial in sorted(trials, key=lambda each: (each.model, each.scenario.name)):
            jobs[f'{name}/{trial.name}'] = name, trial
    return jobs, partial(run_peer, python=str(installed.python), models=folder)
