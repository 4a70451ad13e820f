# SPDX-License-Identifier: Apache-2.0
"""``gsdf import-ndi``: convert an NDI tracker CSV to a bag for `gsdf replay` and ROS."""

from __future__ import annotations

import argparse
from typing import Any

from gsdf_registration.common.command_line import example
from gsdf_registration.common.formatting import format_count


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'import-ndi',
        help='convert NDI tracker CSV to a bag',
        description=
        'Convert recordings of NDI Track (CSV, mm) to one rosbag2 recording (mcap, PointStamped, '
        'metres). Several recordings are merged by time. Samples whose State is not OK are left '
        'out, and so is the Error column: PointStamped has no field for it.',
        **example('gsdf import-ndi hip.csv -o hip_bag', 'gsdf replay hip_bag --model hip.stl'))
    parser.add_argument('csv', nargs='+', metavar='CSV', help='file written by NDI Track')
    parser.add_argument('-o', '--output', required=True, metavar='BAG',
                        help='directory of the new bag')
    parser.add_argument('--tool',
                        help='part of the port label of the probe, if the file has several tools')
    parser.add_argument('--topic',
                        default='/probe/tip',
                        help='topic of the points (default: %(default)s)')
    parser.add_argument('--frame-id', default='tracker', metavar='FRAME',
                        help='frame of the points (default: %(default)s)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Convert, and print how much was converted."""
    from gsdf_registration.common.result import InputError
    from msg_adapters.bag_writer import BagWriter
    from msg_adapters.ndi import read_ndi
    from msg_adapters.recording import merge

    recording = merge([read_ndi(path, args.tool) for path in args.csv])
    if recording.stamps is None:
        raise InputError(f'{", ".join(args.csv)}: there is no Time column, but a bag needs times; '
                         'use gsdf register on the file instead')
    with BagWriter(args.output) as bag:
        for stamp, position in zip(recording.stamps.tolist(), recording.positions):
            bag.write_point(args.topic, stamp, position, args.frame_id)
    seconds = recording.stamps.max() - recording.stamps.min()
    lost = recording.dropped.get('tracking_state', 0)
    print(f'{args.output}: {format_count(len(recording), "point")} in {seconds:.1f} s on '
          f'{args.topic}' + (f'; {lost} samples without tracking left out' if lost else ''))
    return 0
