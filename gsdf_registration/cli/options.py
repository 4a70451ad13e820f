# SPDX-License-Identifier: Apache-2.0
"""Options that several subcommands have in common."""

from __future__ import annotations

import argparse
from typing import Any

from gsdf_registration.common.command_line import three_numbers

MODEL_HELP = ('bone model: a mesh (STL, PLY, OBJ, OFF, 3MF, GLB, VTK, VTP), a segmentation (NIfTI, '
              'NRRD, DICOM SEG), a .gsdf field, or a point cloud with normals')


def add_registration_options(parser: argparse.ArgumentParser, archive: bool = False) -> None:
    """Add the options of `register` and `replay`; ``archive``: see `add_report_options`."""
    add_start_options(parser)
    parser.add_argument('--tip', type=three_numbers, metavar='X,Y,Z',
                        help='position of the tip in the frame of the tool, in the unit of --unit, '
                        'for poses of a tool (default: probe.tip)')
    parser.add_argument('--tip-radius', type=float, metavar='R',
                        help='radius of the ball at the end of the probe, in the unit of --unit; '
                        'the points are then those of its centre (default: probe.tip_radius)')
    parser.add_argument('--json', metavar='OUT',
                        help='write the result as JSON; - for standard output')
    parser.add_argument('--slicer', metavar='OUT.tfm|.h5',
                        help='write the pose as a transform that Slicer opens and that moves the '
                        'model to the tracker frame (.h5 needs the extra "ct")')
    parser.add_argument('--markups', metavar='OUT.mrk.json|.fcsv',
                        help='write the registered points and the touched landmarks as point lists '
                        'of Slicer, tracker frame')
    parser.add_argument('--tf2', metavar='OUT.yaml',
                        help='write the pose as a static transform (tf2_msgs/msg/TFMessage)')
    parser.add_argument('--crtk', metavar='OUT.yaml',
                        help='write the pose as CRTK publishes it (geometry_msgs/msg/PoseStamped)')
    add_report_options(parser, archive)


def add_report_options(parser: argparse.ArgumentParser, archive: bool = False) -> None:
    """Add the report and the label of the case in it; ``archive``: its name may be left out."""
    optional: dict[str, Any] = {'nargs': '?', 'const': ''} if archive else {}
    parser.add_argument('--report', metavar='OUT.html', **optional,
                        help='write an HTML report: the result, its accuracy, pictures and a 3-D '
                        'view of the points on the bone (needs the extra "report")')
    parser.add_argument('--case', metavar='LABEL', default='',
                        help='label of the case, shown first in the report')


def add_start_options(parser: argparse.ArgumentParser) -> None:
    """Add the model unit, the initial guess and the settings."""
    add_model_options(parser)
    parser.add_argument('--landmarks', metavar='FILE', action='append',
                        help='touched landmarks as the initial guess: CSV with the columns '
                        'name, model_x, model_y, model_z, tracker_x, tracker_y, tracker_z and, for '
                        'measurements of the pose, sigma (standard deviation along each axis, in '
                        'the unit of the tracker columns); or the '
                        'ground truth YAML of a recording; or, given twice, two point lists of '
                        'Slicer (.mrk.json, .fcsv) with the same labels, first that on the model, '
                        'then the touched points')
    parser.add_argument('--model-axes', choices=('lps', 'ras'),
                        help='axes of MODEL, to which point lists of Slicer are brought (default: '
                        'those that the file states, else lps)')
    parser.add_argument('--tracker-axes', choices=('lps', 'ras'),
                        help='axes in which the tracker frame is in Slicer; ras if its coordinates '
                        'come through OpenIGTLink, as from PLUS (default: those of MODEL)')
    parser.add_argument('--initial', metavar='JSON',
                        help='initial guess: {"T_tracker_bone": 4x4, metres}; the result that '
                        '--json writes is accepted, too')
    parser.add_argument('--config', metavar='YAML', action='append',
                        help='settings, as in config/registration.yaml; may be repeated, as for '
                        'the tip that gsdf pivot writes')


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how to read MODEL."""
    parser.add_argument('--model-unit', choices=('mm', 'm'),
                        help='unit of the lengths in MODEL (default: mm)')
    parser.add_argument('--label', metavar='N|NAME',
                        help='label of the bone, if MODEL is a segmentation with several')
    parser.add_argument('--body', metavar='N|largest',
                        help='which bone, if MODEL is a mesh of several bones; or all, as one')
