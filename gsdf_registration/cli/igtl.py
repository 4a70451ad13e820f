# SPDX-License-Identifier: Apache-2.0
"""``gsdf igtl``: bridge the tool transforms of a PLUS server to ROS, and the pose to Slicer."""

from __future__ import annotations

import argparse
from typing import Any

from gsdf_registration.common.command_line import example, positive_number
from gsdf_registration.common.result import InputError


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'igtl', help='bridge OpenIGTLink (PLUS, Slicer) to ROS topics',
        description='Receive the tool transforms of an OpenIGTLink server, such as PLUS, and '
        'publish each as a PoseStamped topic /NAME/measured_cp for the node. Transforms of tools '
        'that are not tracked are left out and counted. With --serve, the tools and the pose of '
        'the bone are sent to Slicer. Needs the extra "igtl".',
        **example('gsdf igtl --tool StylusToTracker --tool ReferenceToTracker',
                  'gsdf igtl --host plus.local --serve 18945 --model-axes lps'))
    parser.add_argument('--host', default='127.0.0.1', help='of the server (default: %(default)s)')
    parser.add_argument('--port', type=positive_number, default=18944,
                        help='of the server (default: %(default)s)')
    parser.add_argument('--tool', action='append', default=[], metavar='DEVICE[=TOPIC]',
                        help='publish only this transform, on /NAME/measured_cp or on TOPIC; may '
                        'be repeated (default: all transforms)')
    parser.add_argument('--frame-id', default='', metavar='FRAME',
                        help='frame of the poses (default: the frame in the name of the transform)')
    parser.add_argument('--serve', type=positive_number, metavar='PORT',
                        help='send the tools and the pose of the bone to a client on this port')
    parser.add_argument('--interface', metavar='NAME',
                        help='network interface for --serve (default: this machine only)')
    parser.add_argument('--node', default='/registration', metavar='NAME',
                        help='registration node whose pose is sent (default: %(default)s)')
    parser.add_argument('--model-axes', choices=('lps', 'ras'), default='lps',
                        help='axes of the bone model (default: %(default)s)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Bridge until the process is interrupted."""
    from msg_adapters.extras import needed
    needed('pyigtl', 'igtl', 'OpenIGTLink connections')
    try:
        from gsdf_registration.clients import igtl_bridge
    except ImportError as error:
        raise InputError(
            f'the bridge needs ROS 2 ({error}): source a ROS 2 Jazzy install, or install '
            'gsdf-registration[ros]') from None
    return igtl_bridge.run(args)
