# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks start``: how long the first start of the node takes."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.live.measured_node import STARTUP, node_command, require_ros
from benchmarks.options import add_seed_option, case_of
from gsdf_registration.clients.processes import running
from gsdf_registration.common.command_line import example, positive_number, spinner
from gsdf_registration.common.result import InputError

RATE, SECONDS = 80.0, 12.0      # Hz, s, of the points
POLL = 0.25     # s, between two questions whether the node is active; more would slow it down
CACHES = ('GSDF_CACHE_DIR', 'XDG_CACHE_HOME', 'NUMBA_CACHE_DIR')


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'start',
        help='measure the first start of the node, the first registration, and for how long the '
        'executor pauses meanwhile',
        description='Start the registration node with empty caches, so that it compiles its '
        'kernels and builds the field of the bone, send it 12 seconds of simulated points, and '
        'register. Then start it again with the caches of the first start. A timer of 5 ms in the '
        'executor of the node shows for how long services and messages wait at most.',
        **example('python -m benchmarks start'))
    parser.add_argument('--model', metavar='MESH', help='bone, mm (default: the shipped hip)')
    parser.add_argument('--rounds', type=positive_number, default=2, metavar='N',
                        help='starts with empty caches (default: 2)')
    add_seed_option(parser, 'seed of the points')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print the figures."""
    require_ros()
    from benchmarks.live.figures import simulated

    case = case_of(args.model)
    positions = simulated(case.bone, case.region, RATE, SECONDS, args.seed).positions
    print(f'{case.name}, {len(positions)} points in {SECONDS:g} s\n\n'
          'caches      active s  register s  longest pause ms  pauses > 50 ms')
    for _ in range(args.rounds):
        with tempfile.TemporaryDirectory() as caches:
            for name in ('empty', 'filled'):
                with spinner(f'{name} caches'):
                    line = started(case.bone, positions, caches)
                print(f'{name:10s}{line}', flush=True)
    return 0


def started(model: str, positions: Any, caches: str) -> str:
    """Return the figures of a start with the ``caches`` in this folder, as a line."""
    from benchmarks.live.meter import Meter
    from gsdf_registration.clients.domain import private_domain
    from gsdf_registration.clients.operator import Operator
    with private_domain() as environment, tempfile.TemporaryDirectory() as folder:
        os.environ.update(environment)
        log = Path(folder) / 'pauses'
        module = ['-m', 'benchmarks.start.timed_node', str(log)]
        command = [sys.executable, *module, *node_command(model, folder)[3:]]
        began = time.perf_counter()
        with running(command, 'the node', {name: f'{caches}/{name}' for name in CACHES}) as node, \
                Operator(patience=STARTUP, alive=lambda: node.poll() is None) as operator:
            while operator.state() != 'active':
                if time.perf_counter() - began > STARTUP:
                    raise InputError(f'the node is not active after {STARTUP:g} s')
                time.sleep(POLL)
            active = time.perf_counter() - began
            pauses = [float(pause) for pause in log.read_text().split()[1:]]
            meter = Meter(operator, node.pid)
            meter.await_subscriber(positions[0])
            meter.run(positions, RATE)
            asked = time.perf_counter()
            answer = operator.ask('register')
            took = time.perf_counter() - asked
    if not answer.success:
        return f'{active:10.1f}  {answer.message}'
    return (f'{active:10.1f}{took:12.1f}{1e3 * max(pauses):18.0f}'
            f'{sum(pause > 0.05 for pause in pauses):16d}')
