# SPDX-License-Identifier: Apache-2.0
"""``gsdf import-ndi``: convert NDI tracker CSV to a bag for `gsdf replay` and ROS."""

from __future__ import annotations

import argparse
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

from gsdf_registration.common.command_line import example, number
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from msg_adapters.ndi import TrackedTool


class _Message(NamedTuple):
    """A pose (4, 4) or, without an orientation, a position (3,) of a tool, m."""

    stamp: float
    topic: str
    value: Array


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
    from msg_adapters.bag_writer import BagWriter
    from msg_adapters.ndi import read_tools, topic_of

    if args.rate is not None and not 0.0 < args.rate < float('inf'):
        raise InputError(f'--rate must be a positive number of frames per second, not {args.rate}')
    files = [read_tools(path, args.tool, args.rate) for path in args.csv]
    labels = list(dict.fromkeys(tool.label for tools in files for tool in tools))
    if args.topic and len(labels) > 1:
        raise InputError(f'--topic is the topic of one tool, but there are {len(labels)}: '
                         f'{"; ".join(labels)}; choose one with --tool')
    topics = {label: args.topic or topic_of(label, labels) for label in labels}
    dropped = {label: Counter[str]() for label in labels}
    messages: list[_Message] = []
    for path, tools in zip(args.csv, files):
        for tool in tools:
            dropped[tool.label].update(tool.dropped)
            messages += _messages(path, tool, topics[tool.label], dropped[tool.label])
    if not messages:
        raise InputError(f'{", ".join(args.csv)}: no sample has a valid pose')
    messages.sort(key=lambda message: message.stamp)
    with BagWriter(args.output) as bag:
        for message in messages:
            write = bag.write_pose if message.value.ndim == 2 else bag.write_point
            write(message.topic, message.stamp, message.value, args.frame_id)
    print(_summary(args.output, messages, topics, dropped))
    return 0


def _messages(path: str, tool: TrackedTool, topic: str, dropped: Counter[str]) -> list[_Message]:
    """Return the messages of a tool, and count its invalid poses."""
    import numpy as np

    from msg_adapters.tool_poses import to_poses

    if not len(tool):
        return []
    if tool.stamps is None:
        raise InputError(f'{path}: there is no Time column, but a bag needs times; give the frames '
                         'per second of the Frame column with --rate HZ')
    if tool.quaternions is None:
        return [_Message(stamp, topic, position)
                for stamp, position in zip(tool.stamps.tolist(), tool.positions)]
    poses, invalid = to_poses(tool.positions, tool.quaternions)
    dropped.update(invalid)
    return [_Message(stamp, topic, T) for stamp, T in zip(tool.stamps.tolist(), poses)
            if np.isfinite(T).all()]


def _summary(output: str, messages: list[_Message], topics: dict[str, str],
             dropped: dict[str, Counter[str]]) -> str:
    """Return one line for the bag and one for each tool."""
    from gsdf_registration.cli.summary import counts_by_cause
    written = Counter(message.topic for message in messages)
    lines = [f'{output}: {format_count(len(topics), "tool")}, '
             f'{format_count(len(messages), "sample")} in '
             f'{messages[-1].stamp - messages[0].stamp:.1f} s']
    for label, topic in topics.items():
        lost = counts_by_cause(dict(+dropped[label]))
        lines.append(f'{topic}: {format_count(written[topic], "sample")} of {label}'
                     + (f'; left out: {lost}' if lost else ''))
    return '\n'.join(lines)
