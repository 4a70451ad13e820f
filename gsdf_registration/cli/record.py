# SPDX-License-Identifier: Apache-2.0
"""``gsdf record``: record live topics."""

from __future__ import annotations

import argparse
from typing import Any

from gsdf_registration.common.command_line import example, positive_number
from gsdf_registration.common.result import InputError


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'record', help='record live topics (rosbag2)',
        description='Record topics into a rosbag2 (mcap) until the process is interrupted. A '
        'recording of the topics of the tracker and of ~/events of the node can be replayed with '
        'all that the operator did. Needs ROS 2, but not rosbag2.',
        **example("gsdf record /probe/tip '/registration/*' -o case_17"))
    parser.add_argument('topics', metavar='TOPIC', nargs='+',
                        help="topic, or pattern in quotes such as '/registration/*'; recorded as "
                        'soon as it is published')
    parser.add_argument('-o', '--output', required=True, metavar='BAG', help='directory to create')
    parser.add_argument('--duration', type=positive_number, metavar='SECONDS',
                        help='end after this time (default: when interrupted)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record; return 1 if nothing was received."""
    try:
        from gsdf_registration.clients import recorder
    except ImportError as error:
        raise InputError(
            f'recording needs ROS 2 ({error}): source a ROS 2 Jazzy install, or install '
            'gsdf-registration[ros]') from None
    return recorder.run(args.topics, args.output, args.duration)
