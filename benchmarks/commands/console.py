# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks console``: how fast the console is, and what it costs the node."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.live.measured_node import measured_node, require_ros
from benchmarks.options import add_seed_option, case_of
from gsdf_registration.clients.processes import running
from gsdf_registration.common.command_line import example, number, positive_number, spinner

if TYPE_CHECKING:
    from benchmarks.live.meter import Meter
    from gsdf_registration.clients.operator import Operator
    from gsdf_registration.common.rigid import Array

RATE = 80.0         # Hz, of an optical tracker
TIP_SECONDS = 10.0  # s, during which only the tip moves
OPENINGS = 4        # of the page in one browser


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'console',
        help='measure the console: time to open it, rate of the tip, processor load of the node',
        description='Start the registration node, send it simulated points at 80 Hz, first '
        'without the console and then with it, in turns. Load is processor time in percent of one '
        'core, from /proc/PID/stat. Then the page is opened in a browser without a window. It is '
        'drawn by the processor (SwiftShader), which is much slower than a graphics card. The '
        'time to open it ends when the bone has been drawn; a new browser first compiles the page '
        'and its shaders. The tip follows as often as messages arrive in the page and are drawn '
        'while only the tip moves.',
        **example('python -m benchmarks console --seconds 30'))
    parser.add_argument('--model', metavar='MESH',
                        help='bone, mm (default: the shipped hip, with divided faces)')
    parser.add_argument('--faces', type=positive_number, default=50_000, metavar='N',
                        help='faces are divided until there are as many (default: 50000)')
    parser.add_argument('--seconds', type=number, default=30.0, metavar='S',
                        help='duration of each run (default: 30)')
    parser.add_argument('--rounds', type=positive_number, default=2, metavar='N',
                        help='runs without and with the console, in turns (default: 2)')
    add_seed_option(parser, 'seed of the points')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print the figures."""
    require_ros()
    from benchmarks.live.figures import simulated

    case = case_of(args.model)
    positions = simulated(case.bone, case.region, RATE, args.seconds, args.seed).positions
    with tempfile.TemporaryDirectory() as folder:
        model, faces = divided(case.bone, args.faces, Path(folder))
        with spinner('console'), measured_node(model, positions[0]) as (meter, operator):
            lines = measure(meter, positions, operator, args.rounds)
    print(f'{case.name}, {faces} faces, {args.seconds:g} s per run, chromium with SwiftShader\n')
    for line in lines:
        print(line)
    return 0


def measure(meter: Meter, positions: Array, operator: Operator, rounds: int) -> list[str]:
    """Return the lines of the report."""
    from benchmarks.console.browser import browser
    from benchmarks.live.figures import processor_seconds

    def load(process_seconds: float) -> float:
        return 100.0 * process_seconds * RATE / len(positions)

    def run_once() -> float:
        operator.ask('clear')
        return load(meter.run(positions, RATE).cpu)
    alone, beside, own = [], [], []
    for _ in range(rounds):     # in turns: other programs change the load too
        alone.append(run_once())
        with console(operator) as (process, _):
            before = processor_seconds(process)
            beside.append(run_once())
            own.append(load(processor_seconds(process) - before))
    registered = operator.ask('register').success
    operator.collect(False)
    with console(operator) as (_, url):
        with browser() as first:        # once it is shown, the console has received the bone
            first.open(url)
        with browser() as page:
            opened = [page.open(url) for _ in range(OPENINGS)]
            start = page.counts()
            meter.run(positions[:round(TIP_SECONDS * RATE)], RATE)
            end = page.counts()
    seconds = end.time - start.time
    added = [b - a for a, b in zip(alone, beside)]
    first_time, *later = (f'{each:.1f} s' for each in opened)
    return [f'bone visible      {first_time} after the page is opened in a new browser, then '
            + ', '.join(later),
            f'tip               {(end.batches - start.batches) / seconds:.0f} updates and '
            f'{(end.pictures - start.pictures) / seconds:.0f} pictures per second'
            f'{"" if registered else ", but the bone is not registered"}',
            f'load of the node  {listed(alone)} % without, {listed(beside)} % with the console: '
            f'{sum(added) / rounds:+.1f} % of a core',
            f'load of the console itself, without a page  {listed(own)} %']


def listed(values: list[float]) -> str:
    """Return percentages, one for each round."""
    return ', '.join(f'{value:.1f}' for value in values)


@contextmanager
def console(operator: Operator) -> Iterator[tuple[int, str]]:
    """Run the console during the block; yield its process and its address."""
    from gsdf_registration.visualization.web_access import free_port
    port = free_port()
    command = [sys.executable, '-m', 'gsdf_registration.node.console', '--port', str(port)]
    with running(command, 'the console') as process:
        operator.spin_until(lambda: answers(port), 'the console does not answer')
        yield process.pid, f'http://127.0.0.1:{port}'


def answers(port: int) -> bool:
    """Return whether something listens at a port of this machine."""
    import socket
    with socket.socket() as probe:
        return probe.connect_ex(('127.0.0.1', port)) == 0


def divided(model: str, faces: int, folder: Path) -> tuple[str, int]:
    """Return the file of a mesh of at least ``faces`` faces, and their number."""
    import trimesh
    mesh = trimesh.load_mesh(model)
    if len(mesh.faces) >= faces:
        return model, len(mesh.faces)
    while len(mesh.faces) < faces:
        mesh = mesh.subdivide()
    path = str(folder / f'{Path(model).stem}.ply')
    mesh.export(path)
    return path, len(mesh.faces)
