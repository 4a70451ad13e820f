# SPDX-License-Identifier: Apache-2.0
"""``gsdf import-ndi``: convert NDI tracker CSV to a bag for `gsdf replay` and ROS."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from gsdf_registration.common.command_line import example, number
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from msg_adapters.tracked_tool import TrackedTool


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'import-ndi',
        help='convert NDI tracker CSV to a bag',
        description=
        'Convert recordings of NDI Track or of the Combined API (CSV, mm) to one rosbag2 recording '
        '(mcap, metres). Each tool becomes a PoseStamped topic /NAME/measured_cp, named after its '
        'port label. Several recordings are merged by time. Samples whose state is not OK, or that '
        'have no valid pose, are left out and counted; so is the Error column, for which '
        'PoseStamped has no field.',
        **example('gsdf import-ndi hip.csv -o hip_bag',
                  'gsdf replay hip_bag --model hip.stl --topic /probe/measured_cp '
                  '--tip 0,0,0.15 --reference /array/measured_cp'))
    parser.add_argument('csv', nargs='+', metavar='CSV', help='file of an NDI tracker')
    parser.add_argument('-o', '--output', required=True, metavar='BAG',
                        help='directory of the new bag')
    parser.add_argument('--tool', metavar='NAME',
                        help='part of a port label: write only this tool (default: all tools)')
    parser.add_argument('--topic', metavar='T',
                        help='topic of the poses, for one tool (default: /NAME/measured_cp)')
    parser.add_argument('--rate', type=number, metavar='HZ',
                        help='frames per second of the Frame column, for files without times')
    parser.add_argument('--frame-id', default='tracker', metavar='FRAME',
                        help='frame of the poses (default: %(default)s)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Convert, and print how much was converted."""
    from gsdf_registration.cli.tool_bag import ToolTopic, write_tools
    from msg_adapters.ndi import read_tools, topic_of

    if args.rate is not None and not 0.0 < args.rate < float('inf'):
        raise InputError(f'--rate must be a positive number of frames per second, not {args.rate}')
    tools = [tool for path in args.csv for tool in _timed(path, read_tools(path, args.tool,
                                                                           args.rate))]
    labels = list(dict.fromkeys(tool.label for tool in tools))
    if args.topic and len(labels) > 1:
        raise InputError(f'--topic is the topic of one tool, but there are {len(labels)}: '
                         f'{"; ".join(labels)}; choose one with --tool')
    topics = {label: ToolTopic(args.topic or topic_of(label, labels), args.frame_id)
              for label in labels}
    print(write_tools(args.output, tools, topics))
    return 0


def _timed(path: str, tools: list[TrackedTool]) -> list[TrackedTool]:
    """Return the tools of a file; raise `InputError` if they have no times."""
    if any(len(tool) and tool.stamps is None for tool in tools):
        raise InputError(f'{path}: there is no Time column, but a bag needs times; give the frames '
                         'per second of the Frame column with --rate HZ')
    return tools
