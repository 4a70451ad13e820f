# SPDX-License-Identifier: Apache-2.0
"""``gsdf bench search``: how long the search with no first guess takes, by cores and points."""

from __future__ import annotations

import argparse
import os
from time import perf_counter
from typing import Any

from benchmarks.bones import add_bones_option, bones
from gsdf_registration.cli.common import example

POINTS = 1000           # on the bone
OUTLIERS = (0.0, 0.9)   # share of all points


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'search',
        help='time the search with no first guess',
        description=f'Time the search with no first guess on {POINTS} touched points of each bone '
        'and region, bare and among 90 % uniform outliers, in any attitude; and the whole '
        'registration. Rows hold medians of problems solved once before.',
        **example('gsdf bench search --bones ~/bones'))
    add_bones_option(parser)
    parser.add_argument('--repeats', type=int, default=5, help='runs of each (default: 5)')
    parser.add_argument('--threads', type=int, default=0,
                        help='worker threads; 0: one a core (default: 0)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure, print a table."""
    from benchmarks.cases import find_cases

    threads = args.threads or os.cpu_count() or 1
    print(f'{threads} threads; medians of {args.repeats} runs\n')
    print(f'{"bone":<20}{"region":<18}{"points":>8}{"on strokes":>12}{"search s":>10}'
          f'{"all s":>8}{"TRE rms mm":>12}')
    for case in find_cases(bones(args.bones)):
        for outliers in OUTLIERS:
            measure(case, outliers, args.repeats, threads)
    return 0


def measure(case: Any, outliers: float, repeats: int, threads: int) -> None:
    """Print the row of one bone and region among a share of outliers."""
    import numpy as np

    from benchmarks.cases import bone, region_patch
    from gsdf_registration import register
    from gsdf_registration.common.config import Config
    from gsdf_registration.registration.acceptance import moved
    from gsdf_registration.simulation.interference import Interference
    from gsdf_registration.simulation.probe import Tracker, drag, random_pose

    field, rng = bone(case.bone), np.random.default_rng(0)
    T = random_pose(rng, angle=None)
    points = drag(region_patch(case.bone, case.region), POINTS, rng, tracker=Tracker(sigma=5e-4),
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
        tre = f'{1e3 * moved(T, result.T_tracker_bone, field):.2f}'
    name, _, region = case.name.partition('/')
    print(f'{name:<20}{region:<18}{len(points):>8}{result.used:>12}{search:>10.2f}{total:>8.2f}'
          f'{tre:>12}', flush=True)
