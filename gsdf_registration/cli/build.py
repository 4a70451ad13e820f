# SPDX-License-Identifier: Apache-2.0
"""``gsdf build``: build the gradient-SDF of a bone model."""

from __future__ import annotations

import argparse
import time
from typing import Any

from gsdf_registration.common.command_line import example, number


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'build', help='build the gradient-SDF of a bone model',
        description='Build the gradient-SDF of a bone model. It is stored in the cache and, with '
        '-o, in a file.',
        **example('gsdf build hip.stl --model-unit mm -o hip.gsdf'))
    parser.add_argument('model', metavar='MODEL',
                        help='STL, PLY, OBJ, OFF, or a point cloud with normals')
    parser.add_argument('--model-unit', choices=('mm', 'm'), default='mm',
                        help='unit of the lengths in MODEL (default: mm)')
    parser.add_argument('--voxel', type=number, default=1.0, metavar='MM',
                        help='spacing of the samples near the surface, mm (default: 1)')
    parser.add_argument('-o', '--output', metavar='FIELD.gsdf', help='file to write the field to')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Build the field and print its size."""
    from gsdf_registration.common.config import Config
    from gsdf_registration.field import save_field
    from gsdf_registration.field.model import load_model

    # the same range as for the setting model.voxel_size
    voxel_size = Config.from_flat({'model.voxel_size': 1e-3 * args.voxel}).model.voxel_size
    started = time.perf_counter()
    field = load_model(args.model, args.model_unit, voxel_size)
    seconds = time.perf_counter() - started
    if args.output:
        save_field(field, args.output)
    size = ' x '.join(f'{1e3 * side:.0f}' for side in field.bounds[1] - field.bounds[0])
    print(f'{args.model}: {size} mm, field of {1e3 * field.voxel_size:g} mm voxels, '
          f'{1e-6 * field.nbytes:.1f} MB, {seconds:.2f} s'
          + (f', written to {args.output}' if args.output else ''))
    return 0
