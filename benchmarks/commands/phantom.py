# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks phantom``: a recording of a real phantom with ten targets."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from benchmarks.options import print_table
from gsdf_registration.common.command_line import example

COLUMNS = ('pose', 'target error mean', 'RMS', 'difference', 'stated', 'of the targets',
           'chi-square')
WIDTHS = (34, 19, 8, 12, 9, 16, 12)
ANY_ERROR = 0.05        # m, limit of the stated error: every pose is compared
EMT = Path(__file__).parents[2] / 'config/emt.yaml'


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'phantom',
        help='register a published recording of a real hip phantom, and compare with ten targets',
        description='Register a recording of a hip phantom with an electromagnetic tracker, and '
        'compare the pose with ten targets that were touched beside it. The folder is a checkout '
        'of github.com/utsTianchengLi/Bone-registration-for-CAOS, which is not part of this '
        'repository.',
        **example('python -m benchmarks phantom Bone-registration-for-CAOS'))
    parser.add_argument('folder', type=Path, metavar='FOLDER', help='the checkout')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Register with each of the settings and print the table."""
    from benchmarks.phantom.recording import read_phantom
    from benchmarks.phantom.targets import target_errors
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.session.replay import replay
    from msg_adapters.settings_file import read_config

    phantom, settings = read_phantom(args.folder), read_config(str(EMT))
    runs = {'default settings': (Config(), None), 'config/emt.yaml': (settings, None),
            'published method, from landmarks': (
                settings.replaced({'solver.method': 'paper'}), Landmarks.of(*phantom.landmarks))}
    lines: list[tuple[str, ...]] = [COLUMNS]
    for name, (config, landmarks) in runs.items():
        result = replay(phantom.drag, phantom.field,
                        config.replaced({'limits.max_error': ANY_ERROR}), landmarks)[0]
        if not result.success:
            print(f'{name}: {result.reason}: {result.message}')
            continue
        found = target_errors(result, phantom.targets)
        lines.append((name, *(f'{1e3 * length:.2f}' for length in found[:-1]),
                      f'{found.chi_square:.1f}'))
    print(f'{len(phantom.drag)} samples, {phantom.targets.shape[1]} targets; mm. The difference is '
          'that to the pose that fits the targets\nbest, RMS at the targets; beside it what is '
          'stated for the pose, and what the touches of the\ntargets explain; chi-square has 6 '
          'degrees of freedom\n')
    print_table(lines, WIDTHS)
    return 0
