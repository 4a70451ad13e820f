# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks search``: time of the search without an initial guess."""

from __future__ import annotations

import argparse
import os
from time import perf_counter
from typing import Any

from benchmarks.options import add_bones_option, bones
from gsdf_registration.common.command_line import example, natural_number, positive_number

POINTS = 1000           # on the bone
OUTLIERS = (0.0, 0.9)   # share of all points


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'search', help='time the search without an initial guess',
        description='Measure the time of the search without an initial guess, and of the whole '
        f'registration, on {POINTS} points of each bone and region, without outliers and with '
        '90 % uniform outliers, at any rotation. The table shows medians after one warm-up.',
        **example('python -m benchmarks search --bones ~/bones'))
    add_bones_option(parser)
    parser.add_argument('--repeats', type=positive_number, default=5, metavar='N',
                        help='registrations per row (default: 5)')
    parser.add_argument('--threads', type=natural_number, default=0, metavar='N',
                        help='worker threads; 0: one per core (default: 0)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    from benchmarks.protocol.cases import find_cases

    threads = args.threads or os.cpu_count() or 1
    print(f'{threads} threads; medians of {args.repeats} runs\n')
    print(f'{"bone":<20}{"region":<18}{"points":>8}{"on strokes":>12}{"search s":>10}'
          f'{"all s":>8}{"TRE rms mm":>12}')
    for case in find_cases(bones(args.bones)):
        for outliers in OUTLIERS:
            measure(case, outliers, args.repeats, threads)
    return 0


def measure(case: Any, outliers: float, repeats: int, threads: int) -> None:
    """Print the row of one bone and region with a share of outliers."""
    import numpy as np

    from benchmarks.protocol.cases import bone, region_patch
    from gsdf_registration import register
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.rigid import rms_displacement
    from gsdf_registration.simulation.interference import Interference
    from gsdf_registration.simulation.probe import Tracker, random_pose, simulate_scan

    field, rng = bone(case.bone), np.random.default_rng(0)
    T = random_pose(rng, angle=None)
    points = simulate_scan(region_patch(case.bone, case.region), POINTS, rng,
                           tracker=Tracker(sigma=5e-4),
                           interference=Interference(uniform=outliers), T_tracker_bone=T).positions
    config = Config.from_flat({'search.threads': threads})
    seconds = []
    for _ in range(repeats + 1):
        started = perf_counter()
        result = register(points, field, config)
        seconds.append((result.timing_s['search'], perf_counter() - started))
    search, total = np.median(seconds[1:], axis=0)
    tre = '-'
    if result.T_tracker_bone is not None:
        error = rms_displacement(T, result.T_tracker_bone, field.surface_points)
        tre = f'{1e3 * error:.2f}'
    name, _, region = case.name.partition('/')
    print(f'{name:<20}{region:<18}{len(points):>8}{result.used:>12}{search:>10.2f}{total:>8.2f}'
          f'{tre:>12}', flush=True)
