# SPDX-License-Identifier: Apache-2.0
"""Options that several subcommands have in common."""

from __future__ import annotations

import argparse

MODEL_HELP = 'bone model: STL, PLY, OBJ, OFF, a .gsdf field, or a point cloud with normals'


def add_registration_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `register` and `replay` have in common."""
    add_start_options(parser)
    parser.add_argument('--json', metavar='OUT',
                        help='write the result as JSON; - for standard output')
    parser.add_argument('--report', metavar='OUT.html',
                        help='write an HTML report with the result, its accuracy and a 3D view of '
                        'the points on the bone (needs the extra "report")')


def add_start_options(parser: argparse.ArgumentParser) -> None:
    """Add the model unit, the initial guess and the settings."""
    parser.add_argument('--model-unit', choices=('mm', 'm'),
                        help='unit of the lengths in MODEL (default: mm)')
    parser.add_argument('--landmarks', metavar='FILE',
                        help='touched landmarks as the initial guess: CSV with the columns '
                        'name, model_x, model_y, model_z, tracker_x, tracker_y, tracker_z, or the '
                        'ground truth YAML of a recording')
    parser.add_argument('--initial', metavar='JSON',
                        help='initial guess: {"T_tracker_bone": 4x4, metres}; the result that '
                        '--json writes is accepted, too')
    parser.add_argument('--config', metavar='YAML', help='settings, as in config/registration.yaml')
