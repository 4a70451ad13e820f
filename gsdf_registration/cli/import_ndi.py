# SPDX-License-Identifier: Apache-2.0
"""``gsdf import-ndi``: NDI tracker CSV to a bag that `gsdf replay` and ROS can play."""

from __future__ import annotations

import argparse
from typing import Any

from gsdf_registration.cli.common import example
from gsdf_registration.common.formatting import counted


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'import-ndi',
        help='convert NDI tracker CSV to a bag',
        description=
        'Convert recordings of NDI Track (CSV, mm) to one rosbag2 recording (mcap, PointStamped, '
        'metres); several are merged in the order of their times.  Samples whose State is not OK '
        'are left out, and so is the Error column, for which PointStamped has no room.',
        **example('gsdf import-ndi hip.csv -o hip_run\n  gsdf replay hip_run --model hip.stl'))
    parser.add_argument('csv', nargs='+', metavar='CSV', help='file written by NDI Track')
    parser.add_argument('-o', '--output', required=True, metavar='BAG',
                        help='directory of the bag to be written')
    parser.add_argument('--tool',
                        help='part of the port label of the probe, if there are several tools')
    parser.add_argument('--topic',
                        default='/probe/tip',
                        help='topic of the points (default: %(default)s)')
    parser.add_argument('--frame-id', default='tracker', metavar='FRAME',
                        help='frame of the points (default: %(default)s)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Convert, and say what was converted."""
    from gsdf_registration.common.result import InputError
    from msg_adapters.bag_writer import BagWriter
    from msg_adapters.ndi import read_ndi
    from msg_adapters.recording import merge

    recording = merge([read_ndi(path, args.tool) for path in args.csv])
    if recording.stamps is None:
        raise InputError(f'{", ".join(args.csv)}: there is no Time column, and a bag needs times; '
                         'register the points instead')
    with BagWriter(args.output) as bag:
        for stamp, position in zip(recording.stamps.tolist(), recording.positions):
            bag.write_point(args.topic, stamp, position, args.frame_id)
    seconds = recording.stamps.max() - recording.stamps.min()
    lost = recording.dropped.get('tracking_state', 0)
    print(f'{args.output}: {counted(len(recording), "point")} in {seconds:.1f} s on {args.topic}'
          + (f'; samples without tracking, left out: {lost}' if lost else ''))
    return 0
