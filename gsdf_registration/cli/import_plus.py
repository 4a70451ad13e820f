# SPDX-License-Identifier: Apache-2.0
"""``gsdf import-plus``: convert recordings of PLUS to a bag for `gsdf replay` and ROS."""

from __future__ import annotations

import argparse
from typing import Any

from gsdf_registration.common.command_line import example


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'import-plus', help='convert recordings of PLUS to a bag',
        description='Convert the tool transforms of PLUS recordings (.mha, .mhd, .nrrd; mm) to one '
        'rosbag2 recording (mcap, metres). StylusToTracker becomes the PoseStamped topic '
        '/stylus/measured_cp in the frame tracker. Several recordings are merged by time. '
        'Transforms whose status is not OK are left out and counted.',
        **example('gsdf import-plus stylus.igs.mha -o knee_bag',
                  'gsdf replay knee_bag --model knee.stl --topic /stylus/measured_cp '
                  '--tip 0,0,0.15 --reference /reference/measured_cp'))
    parser.add_argument('recordings', nargs='+', metavar='FILE', help='recording of PLUS')
    parser.add_argument('-o', '--output', required=True, metavar='BAG',
                        help='directory of the new bag')
    parser.add_argument('--tool', metavar='NAME',
                        help='part of the name of a transform: write only this one (default: all)')
    parser.add_argument('--frame-id', default='', metavar='FRAME',
                        help='frame of the poses (default: the frame in the name of the transform)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Convert, and print how much was converted."""
    from gsdf_registration.cli.tool_bag import ToolTopic, write_tools
    from msg_adapters.igtl import frames_of, ros_name
    from msg_adapters.plus import read_plus

    tools = [tool for path in args.recordings for tool in read_plus(path, args.tool)]
    labels = list(dict.fromkeys(tool.label for tool in tools))
    names = [frames_of(label)[0] for label in labels]
    topics = {}
    for label, name in zip(labels, names):
        # a tool can be recorded in several frames
        unique = name if names.count(name) == 1 else ros_name(label)
        topics[label] = ToolTopic(f'/{unique}/measured_cp', args.frame_id or frames_of(label)[1])
    print(write_tools(args.output, tools, topics))
    return 0
