# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks live``: latency and processor load of the live pose of the node."""

from __future__ import annotations

import argparse
from typing import Any

from benchmarks.live.measured_node import measured_node, require_ros
from benchmarks.options import add_seed_option, case_of
from gsdf_registration.common.command_line import example, number, spinner
from gsdf_registration.common.result import InputError

WIDTHS = (8, 8, 6, 10, 12, 7, 8, 7, 7, 7, 7, 9, 9, 8)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'live',
        help='measure the live pose of the node: latency, processor load, lost points',
        description='Start the registration node as a process, send it simulated points over DDS '
        'and receive its live pose. The latency of a point (ms) is the time from its publication '
        'to the arrival of the first live pose with the same or a later stamp; points sent before '
        'the status is ready do not count. CPU is the share of one core that the node uses in the '
        'whole run, searches included. Lost points were never counted by the node, rejected '
        'points were not kept, unanswered points were not followed by a live pose. First and '
        'ready are the times of the first pose and of the status ready.',
        **example('python -m benchmarks live --seconds 60 --rates 80,1000'))
    parser.add_argument('--model', metavar='MESH', help='bone, mm (default: the shipped hip)')
    parser.add_argument('--region', metavar='NAME',
                        help='region that is touched (default: from the file name: hip, femur, '
                        'tibia; else from the shape)')
    parser.add_argument('--rates', metavar='HZ,...', default='80,1000',
                        help='points per second, one run for each (default: 80,1000)')
    parser.add_argument('--seconds', type=number, default=60.0, metavar='S',
                        help='duration of a run (default: 60)')
    add_seed_option(parser, 'seed of the points')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    require_ros()
    from benchmarks.live.figures import COLUMNS, line, simulated, true_error

    rates = read_rates(args.rates)
    if not args.seconds >= 1.0:
        raise InputError('--seconds must be at least 1')
    case = case_of(args.model, args.region)
    print(f'{case.name}, {args.seconds:g} s per run; latency in ms\n')
    show(COLUMNS)
    for rate in rates:
        recording = simulated(case.bone, case.region, rate, args.seconds, args.seed)
        with spinner(f'{rate:g} points per second'), \
                measured_node(case.bone, recording.positions[0]) as (meter, _):
            measured = meter.run(recording.positions, rate)
        error = None if measured.pose is None else true_error(
            measured.pose, recording.T_tracker_bone, case.bone)
        show(line(measured, rate, error))
    return 0


def read_rates(text: str) -> list[float]:
    """Return the rates of the option, Hz."""
    try:
        rates = [float(word) for word in text.split(',')]
    except ValueError:
        rates = []
    if not rates or not all(1.0 <= rate <= 5000.0 for rate in rates):
        raise InputError(f'--rates must be numbers from 1 to 5000, such as 80,1000, not "{text}"')
    return rates


def show(cells: tuple[str, ...]) -> None:
    """Print a line of the table."""
    print(''.join(f'{cell:>{width}}' for cell, width in zip(cells, WIDTHS)), flush=True)
