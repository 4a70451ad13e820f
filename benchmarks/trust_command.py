# SPDX-License-Identifier: Apache-2.0
"""``gsdf bench trust``: how often a pose that is claimed is wrong, and a good problem refused."""

from __future__ import annotations

import argparse
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.bones import about, add_bones_option, bones
from gsdf_registration.cli.common import example, read_config
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from benchmarks.cases import Case
    from benchmarks.journal import Row
    from benchmarks.protocol import Scenario, Trial
    from gsdf_registration.common.config import Config

WIDTHS = (18, 7, 6, 8, 6, 8, 11, 7, 7, 10, 7, 6)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'trust',
        help='count wrong poses that are claimed, and good problems that are refused',
        description='Register simulated points of a bone with no first guess, disturbed in every '
        'way, of the wrong bone, of no bone; count what is claimed, refused, right and wrong. '
        'Rows already in FILE are not computed again. Wrong is any pose of a wrong bone, an '
        'object or noise, and else one off by more than 3 mm, or 1 mm + 3 times what it '
        'predicts (RMS over the bone). Well-posed is the right bone, touched in one of the usual '
        'regions, where 1.5 times the Cramer-Rao bound of the error is within '
        'limits.max_predicted_tre and limits.max_bone_tre.',
        **example('gsdf bench trust --bones ~/bones --trials 3000 -o trust.tsv'))
    add_bones_option(parser)
    parser.add_argument('--regions', metavar='NAME,...', default='',
                        help='of every bone (default: by its name: hip, femur, tibia; else by '
                        'its shape)')
    parser.add_argument('--trials', type=int, default=300, metavar='N', help='(default: 300)')
    parser.add_argument('--scenarios', metavar='NAME,...', default='',
                        help='only these; a name that ends in * stands for many (default: all)')
    parser.add_argument('--seed', type=int, default=0, help='of the first trials (default: 0)')
    parser.add_argument('--only', metavar='BONE/REGION/SCENARIO/SEED',
                        help='run this trial alone and tell all about it')
    parser.add_argument('-o', '--output', metavar='FILE.tsv',
                        help='write a row for each trial, or go on where it ends')
    parser.add_argument('--config', metavar='YAML',
                        help='settings, as in config/registration.yaml')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the trials, print the tables."""
    from benchmarks.cases import find_cases
    from benchmarks.protocol import trials
    from benchmarks.runner import run_all
    from benchmarks.trust import attempt

    if args.seed < 0 or args.trials < 1:
        raise InputError('--seed must not be negative and --trials must be at least 1')
    cases = find_cases(bones(args.bones), [word for word in args.regions.split(',') if word])
    config = read_config(args.config).replaced({'search.threads': 1})
    if args.only:
        return tell(named(args.only, cases), config)
    chosen = list(islice(trials(cases, scenarios(args.scenarios), args.seed), args.trials))
    if not chosen:
        raise InputError('these scenarios cannot be had of these bones; give more of them')
    rows = run_all({trial.name: trial for trial in chosen}, partial(attempt, config=config),
                   output=Path(args.output) if args.output else None,
                   about=about(cases, args.seed, config))
    show(rows)
    return 0


def scenarios(text: str) -> list[Scenario]:
    """Return the scenarios of a list of names or patterns; all, if it is empty."""
    from fnmatch import fnmatchcase

    from benchmarks.protocol import SCENARIOS
    words = text.split(',') if text else ['*']
    for word in words:
        if not any(fnmatchcase(name, word) for name in SCENARIOS):
            raise InputError(
                f'scenario "{word}" is not known; say one of {", ".join(SCENARIOS)}')
    return [scenario for name, scenario in SCENARIOS.items()
            if any(fnmatchcase(name, word) for word in words)]


def named(name: str, cases: list[Case]) -> Trial:
    """Return the trial of a name as in the table of a run over the same bones."""
    from benchmarks.protocol import SCENARIOS, trials
    where, _, seed = name.rpartition('/')
    case_name, _, word = where.rpartition('/')
    if (word not in SCENARIOS or case_name not in [case.name for case in cases]
            or not seed.isdecimal()):
        raise InputError(f'--only {name}: say BONE/REGION/SCENARIO/SEED, one of '
                         f'{", ".join(case.name for case in cases)} and of {", ".join(SCENARIOS)}')
    for trial in trials(cases, [SCENARIOS[word]], int(seed)):
        if trial.name == name:
            return trial
        if trial.seed > int(seed):
            break
    raise InputError(f'--only {name}: this scenario cannot be had of this bone and region')


def tell(trial: Trial, config: Config) -> int:
    """Print all about one trial."""
    from benchmarks.trust import attempt
    for key, value in {'trial': trial.name, **attempt(trial, config)}.items():
        print(f'{key:<18}{value:.6g}' if isinstance(value, float) else f'{key:<18}{value}')
    return 0


def show(rows: list[Row]) -> None:
    """Print the confusion table, and by name whatever went wrong."""
    from benchmarks.trust import (
        BASIN,
        COLUMNS,
        basins,
        faulty_refusals,
        ideally_wrong,
        table,
        wrong_claims,
    )
    print('basin: poses found, refused or not, in the right one; efficiency: RMS and median error '
          'of right poses\nin units of the Cramer-Rao bound; TRE and predicted: RMS over the whole '
          'bone and over right poses, mm;\nsearch, solve: median, ms, one thread\n')
    for cells in [COLUMNS, *table(rows)]:
        print(f'{cells[0]:<{WIDTHS[0]}}'
              + ''.join(f'{cell:>{width}}' for cell, width in zip(cells[1:-1], WIDTHS[1:]))
              + f'  {cells[-1]}')
    refused, well = faulty_refusals(rows)
    wrong = wrong_claims(rows)
    print(f'\n{len(wrong)} of {len(rows)} claimed and wrong; by chance {ideally_wrong(rows):.1f} '
          'would be of an ideal estimator that claims the same')
    for row in wrong:
        print(f'  {row["job"]}  {detail(row)}')
    print(f'{len(refused)} of {well} well-posed refused'
          + (f' ({100.0 * len(refused) / well:.1f} %)' if well else ''))
    for row in refused:
        print(f'  {row["job"]}  {row["reason"]}  {detail(row)}')
    astray, asked = basins(rows)
    print(f'{len(astray)} of {asked} poses of the protocol, refused or not, more than '
          f'{1e3 * BASIN:.0f} mm off where the bone was touched'
          + (f' ({100.0 * len(astray) / asked:.1f} %)' if asked else ''))
    for row in astray:
        print(f'  {row["job"]}  {row["verdict"]}  {row["reason"]}')


def detail(row: Row) -> str:
    """Say what is known of a trial, in a line."""
    import numpy as np

    def mm(key: str) -> str:
        return '-' if row[key] is None else f'{1e3 * row[key]:.2f}'
    ratio = row['runner_up_ratio']
    off = '-' if row['nees'] is None else f'{np.sqrt(row["nees"] / 6.0):.1f}'
    return (f'TRE {mm("tre_rms_m")} predicted {mm("predicted_rms_m")} bound {mm("bound_rms_m")} '
            f'sigma {mm("sigma_m")} mm, efficiency {off}, '
            f'runner-up {"-" if ratio is None else f"{ratio:.2f}"}, '
            f'{row["inliers"]} of {row["used"]} inliers, model {Path(row["model"]).stem}')
