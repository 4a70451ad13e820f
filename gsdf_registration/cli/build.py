# SPDX-License-Identifier: Apache-2.0
"""``gsdf build``: build the gradient-SDF of a bone model."""

from __future__ import annotations

import argparse
import time
from typing import Any

from gsdf_registration.cli import options
from gsdf_registration.common.command_line import example, number


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'build', help='build the gradient-SDF of a bone model',
        description='Build the gradient-SDF of a bone model. It is stored in the cache and, with '
        '-o, in a file. The surface of a segmentation is that of its smoothed label, in the '
        'coordinates of the patient, LPS.',
        **example('gsdf build hip.stl --model-unit mm -o hip.gsdf',
                  'gsdf build ct_labels.nii.gz --label 3 -o femur.gsdf'))
    parser.add_argument('model', metavar='MODEL', help=options.MODEL_HELP)
    options.add_model_options(parser)
    parser.add_argument('--voxel', type=number, default=1.0, metavar='MM',
                        help='spacing of the samples near the surface, mm (default: 1)')
    parser.add_argument('-o', '--output', metavar='FIELD.gsdf', help='file to write the field to')
    parser.set_defaults(run=run, model_unit='mm')


def run(args: argparse.Namespace) -> int:
    """Build the field and print its size."""
    from gsdf_registration.common.config import Config
    from gsdf_registration.field import save_field
    from gsdf_registration.field.model import find_model, load_model
    from msg_adapters.slicer import model_axes

    # the same range as for the setting model.voxel_size
    voxel_size = Config.from_flat({'model.voxel_size': 1e-3 * args.voxel}).model.voxel_size
    started = time.perf_counter()
    field = load_model(args.model, args.model_unit, voxel_size, args.label or '', args.body or '')
    seconds = time.perf_counter() - started
    if args.output:
        save_field(field, args.output)
    size = ' x '.join(f'{1e3 * side:.0f}' for side in field.bounds[1] - field.bounds[0])
    axes = model_axes(find_model(args.model))
    stated = f' in the axes {axes.upper()}' if axes else ''
    print(f'{args.model}: {size} mm{stated}, field of {1e3 * field.voxel_size:g} mm voxels, '
          f'{1e-6 * field.nbytes:.1f} MB, {seconds:.2f} s'
          + (f', written to {args.output}' if args.output else ''))
    return 0
