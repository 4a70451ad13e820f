# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks trust``: how many accepted poses are wrong, and good problems refused."""

from __future__ import annotations

import argparse
from functools import partial
from itertools import islice
from pathlib import Path
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
    from benchmarks.protocol.cases import Case
    from benchmarks.protocol.trials import Scenario, Trial
    from gsdf_registration.common.config import Config

WIDTHS = (18, 7, 6, 8, 6, 12, 8, 11, 7, 7, 10, 7, 6)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'trust',
        help='count accepted poses that are wrong, and well-posed problems that are refused',
        description='Register simulated points without an initial guess: points with all kinds of '
        'interference, points of a wrong bone and points of no bone. Count the right, wrong and '
        'refused poses. Rows already in FILE are not computed again. A pose is wrong if the points '
        'are of a wrong bone, an object or noise, or if it is more than 5 mm off where the bone '
        'was touched (mean). Its error is understated if a required place is off by more than '
        'twice its stated 95 % error + 0.5 mm. A problem is well-posed if the right bone is '
        'touched in one of the usual regions and 1.5 times the Cramer-Rao bound of the error, with '
        'the deviation of an inexact model as correlated noise, is within limits.max_error where '
        'limits.require demands it.',
        **example('python -m benchmarks trust --bones ~/bones --trials 3000 -o trust.tsv'))
    add_bones_option(parser)
    parser.add_argument('--regions', metavar='NAME,...', default='',
                        help='regions of every bone (default: from the file name: hip, femur, '
                        'tibia; else from the shape)')
    parser.add_argument('--trials', type=positive_number, default=300, metavar='N',
                        help='number of trials (default: 300)')
    parser.add_argument('--scenarios', metavar='NAME,...', default='',
                        help='only these scenarios; * matches any text (default: all)')
    add_seed_option(parser, 'seed of the first trials')
    parser.add_argument('--only', metavar='BONE/REGION/SCENARIO/SEED',
                        help='run one trial and print all its values')
    add_table_options(parser, 'trial')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the trials and print the tables."""
    from benchmarks.protocol.cases import find_cases
    from benchmarks.protocol.trials import trials
    from benchmarks.trust.trial import run_trial

    cases = find_cases(bones(args.bones), [word for word in args.regions.split(',') if word])
    config = single_threaded(args)
    if args.only:
        return print_trial(find_trial(args.only, cases), config)
    selected = list(islice(trials(cases, scenarios(args.scenarios), args.seed), args.trials))
    if not selected:
        raise InputError('none of these scenarios is possible with these bones; give more bones')
    show(run_table(args, cases, config, {trial.name: trial for trial in selected},
                   partial(run_trial, config=config)))
    return 0


def scenarios(text: str) -> list[Scenario]:
    """Return the scenarios of a list of names or patterns; all if it is empty."""
    from fnmatch import fnmatchcase

    from benchmarks.protocol.trials import SCENARIOS
    words = text.split(',') if text else ['*']
    for word in words:
        if not any(fnmatchcase(name, word) for name in SCENARIOS):
            raise InputError(
                f'scenario "{word}" is unknown; choose one of {", ".join(SCENARIOS)}')
    return [scenario for name, scenario in SCENARIOS.items()
            if any(fnmatchcase(name, word) for word in words)]


def find_trial(name: str, cases: list[Case]) -> Trial:
    """Return the trial of a name, as in the table of a run with the same bones."""
    from benchmarks.protocol.trials import SCENARIOS, trials
    where, _, seed = name.rpartition('/')
    case_name, _, word = where.rpartition('/')
    if (word not in SCENARIOS or case_name not in [case.name for case in cases]
            or not seed.isdecimal()):
        raise InputError(f'--only {name}: give BONE/REGION/SCENARIO/SEED, one of '
                         f'{", ".join(case.name for case in cases)} and of {", ".join(SCENARIOS)}')
    for trial in trials(cases, [SCENARIOS[word]], int(seed)):
        if trial.name == name:
            return trial
        if trial.seed > int(seed):
            break
    raise InputError(f'--only {name}: this scenario is not possible with this bone and region')


def print_trial(trial: Trial, config: Config) -> int:
    """Run one trial and print all its values."""
    from benchmarks.trust.trial import run_trial
    for key, value in {'trial': trial.name, **run_trial(trial, config)}.items():
        print(f'{key:<18}{value:.6g}' if isinstance(value, float) else f'{key:<18}{value}')
    return 0


def show(rows: list[Row]) -> None:
    """Print the confusion table, and the names of all failures."""
    from benchmarks.trust.tables import (
        COLUMNS,
        faults,
        faulty_refusals,
        not_found,
        table,
    )
    from benchmarks.trust.trial import NEAR_TRUTH
    print('found: share of poses near the truth, refused or not; efficiency: RMS and median error '
          'of right poses\nin units of the Cramer-Rao bound; TRE and predicted: RMS over the whole '
          'bone and over right poses, mm;\nsearch, solve: median, ms, one thread\n')
    print_table([COLUMNS, *table(rows)], WIDTHS)
    refused, well = faulty_refusals(rows)
    print()
    for verdict in ('wrong', 'understated'):
        found = faults(rows, verdict)
        print(f'{len(found)} of {len(rows)} accepted and {verdict}')
        for row in found:
            print(f'  {row["job"]}  {detail(row)}')
    print(f'{len(refused)} of {well} well-posed refused'
          + (f' ({100.0 * len(refused) / well:.1f} %)' if well else ''))
    for row in refused:
        print(f'  {row["job"]}  {row["reason"]}  {detail(row)}')
    missed, count = not_found(rows)
    print(f'{len(missed)} of {count} poses of the protocol, refused or not, more than '
          f'{1e3 * NEAR_TRUTH:.0f} mm off where the bone was touched'
          + (f' ({100.0 * len(missed) / count:.1f} %)' if count else ''))
    for row in missed:
        print(f'  {row["job"]}  {row["verdict"]}  {row["reason"]}')


def detail(row: Row) -> str:
    """Return the values of a trial on one line."""
    import numpy as np

    def mm(key: str) -> str:
        return '-' if row[key] is None else f'{1e3 * row[key]:.2f}'
    ratio = row['runner_up_ratio']
    efficiency = '-' if row['nees'] is None else f'{np.sqrt(row["nees"] / 6.0):.1f}'
    return (f'TRE {mm("tre_rms_m")} predicted {mm("predicted_rms_m")} bound {mm("bound_rms_m")} '
            f'sigma {mm("sigma_m")} mm, efficiency {efficiency}, '
            f'runner-up {"-" if ratio is None else f"{ratio:.2f}"}, '
            f'{row["inliers"]} of {row["used"]} inliers, model {Path(row["model"]).stem}')
