# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks landmarks``: what a joint centre adds to points at the knee."""

from __future__ import annotations

import argparse
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.options import (
    add_bones_option,
    add_seed_option,
    add_table_options,
    bones,
    print_table,
    run_table,
)
from gsdf_registration.common.command_line import example, positive_number
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from benchmarks.execution.result_table import Row
    from benchmarks.landmarks.trial import HipTrial
    from benchmarks.protocol.cases import Case

# m: standard deviation of the error of the model, that of the hip centre along each axis, and a
# mistake of the hip centre. An error of 2 mm is 2 mm along each axis, or in all.
SCENARIOS = ((0.0003, 0.002, 0.0), (0.0003, 0.002 / 3.0**0.5, 0.0), (0.0, 0.002, 0.0),
             (0.0, 0.002 / 3.0**0.5, 0.0), (0.0003, 0.002, 0.03), (0.0, 0.002, 0.03))
COLUMNS = ('model, hip centre', 'trials', 'TRE mm', 'with', 'ratio', 'median', 'with', 'worst',
           'with', 'predicted', 'with', 'NEES/6', 'with', 'left out')
WIDTHS = (46, *[10] * (len(COLUMNS) - 1))


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'landmarks', help='measure what the hip centre adds to points on the condyles',
        description='Touch the condyles of each femur, with a model that is exact or off by '
        '0.3 mm (smooth, 15 mm), and compare the error over the whole bone (RMS) with and without '
        'the centre of the hip joint as a landmark with a standard deviation. Poses are accepted '
        'without limits.',
        **example('python -m benchmarks landmarks --bones ~/bones --trials 100'))
    add_bones_option(parser)
    parser.add_argument('--trials', type=positive_number, default=20, metavar='N',
                        help='number of trials of each scenario (default: 20)')
    add_seed_option(parser, 'seed of the first trials')
    add_table_options(parser, 'trial')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the trials and print a table."""
    from benchmarks.landmarks.trial import run_trial
    from msg_adapters.settings_file import read_config

    cases = femurs(bones(args.bones))
    config = read_config(args.config)
    trials = select(cases, args.trials, args.seed)
    rows = run_table(args, cases, config, {trial.name: trial for trial in trials},
                     partial(run_trial, config=config))
    print('TRE: RMS over the bone, of all trials; worst: largest TRE (RMS over the bone) of a '
          'trial;\npredicted: RMS; NEES: e^T C^-1 e of the pose, mean over trials without the '
          'worst 5 %; "with": with the hip centre\n')
    names = dict.fromkeys(trial.scenario for trial in trials)
    print_table([COLUMNS, *(summary(name, [row for row in rows if row['scenario'] == name])
                            for name in names)], WIDTHS)
    return 0


def femurs(files: list[Path]) -> list[Case]:
    """Return the condyles of each femur; raise `InputError` if there is no femur."""
    from benchmarks.landmarks.trial import REGION
    from benchmarks.protocol.cases import Case
    found = [Case(str(file), REGION) for file in files if 'femur' in file.stem.lower()]
    if not found:
        raise InputError('none of the bones is a femur by its file name; give a folder with one')
    return found


def select(cases: list[Case], count: int, seed: int) -> list[HipTrial]:
    """Return ``count`` trials of each scenario, over all bones in turn."""
    from benchmarks.landmarks.trial import HipTrial
    return [HipTrial(case, model_error, sigma, seed + k, mistake)
            for model_error, sigma, mistake in SCENARIOS
            for k, case in enumerate(islice(cycle(cases), count))]


def summary(scenario: str, rows: list[Row]) -> tuple[str, ...]:
    """Return the cells of a scenario."""
    import numpy as np

    from gsdf_registration.common.rigid import rms

    def column(name: str) -> np.ndarray:
        return np.array([row[name] for row in rows], dtype=np.float64)

    def nees(which: str) -> float:
        values = np.sort(column(f'{which}_nees'))
        return float(values[:max(1, round(0.95 * len(values)))].mean() / 6.0)
    alone, fused = (1e3 * column(f'{which}_tre_m') for which in ('alone', 'fused'))
    predicted = [1e3 * rms(column(f'{which}_predicted_m')) for which in ('alone', 'fused')]
    return (scenario, str(len(rows)), *(f'{value:.2f}' for value in (
        rms(alone), rms(fused), rms(fused) / rms(alone), np.median(alone), np.median(fused),
        alone.max(), fused.max(), *predicted, nees('alone'), nees('fused'))),
        str(int((column('landmark_used') == 0.0).sum())))

