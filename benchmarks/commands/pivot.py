# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks pivot``: compare pivot calibration with scikit-surgerycalibration."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from benchmarks.options import add_seed_option
from gsdf_registration.common.command_line import example, positive_number

if TYPE_CHECKING:
    import numpy as np

    from gsdf_registration.common.rigid import Array
    from gsdf_registration.simulation.pivoting import PivotRecording

    # a tip (3,), m, or None if the method found none, and the time it took, s
    Answer = tuple[Array | None, float]

LIBRARY = 'scikit-surgerycalibration'
SECONDS, RATE = 20.0, 20.0
JOINT = 'swing of a leg, 30 s'    # its hip moves slowly by 1.5 mm per axis
PEER_LIMIT = 3600.0     # s, for all recordings


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'pivot', help='compare pivot calibration with scikit-surgerycalibration',
        description='Measure the error of the tip in simulated pivot recordings, also with the '
        'three methods of scikit-surgerycalibration. The recordings have noise only, noisy '
        'orientations, wrong readings, slips of the tip, or poses on the way to the divot. In '
        'the last scenario a leg swings about its hip.',
        **example('python -m benchmarks pivot --recordings 100'))
    parser.add_argument('--recordings', type=positive_number, default=50, metavar='N',
                        help='recordings per scenario (default: 50)')
    add_seed_option(parser, 'seed of the recordings')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    import numpy as np

    print(f'{args.recordings} recordings per scenario of {SECONDS:.0f} s at {RATE:.0f} Hz; error '
          'of the tip\n')
    print(f'{"scenario":<24}{"method":<24}{"median mm":>10}{"p95 mm":>10}{"worst mm":>10}'
          f'{"rejected":>10}{"ms":>8}')
    made = {name: [make(np.random.default_rng([args.seed, i])) for i in range(args.recordings)]
            for name, make in scenarios().items()}
    recordings = [recording for group in made.values() for recording in group]
    answers = {'gsdf_registration': [ours(recording, name == JOINT)
                                     for name, group in made.items() for recording in group]}
    peers, missing = peer_answers(recordings)
    answers.update(peers)
    for i, (name, group) in enumerate(made.items()):
        rows = slice(i * args.recordings, (i + 1) * args.recordings)
        for method, found in answers.items():
            print(row(name, method, group, found[rows]))
    if missing:
        print(f'\n{LIBRARY} not measured: {missing}')
    return 0


def scenarios() -> dict[str, Callable[[np.random.Generator], PivotRecording]]:
    """Return a function for each scenario that simulates a recording."""
    import numpy as np

    from gsdf_registration.simulation.pivoting import PoseFaults, PoseNoise, leg_swing, pivoting

    def recorded(**faults: Any) -> Callable[..., PivotRecording]:
        return lambda rng: pivoting(rng, SECONDS, RATE, faults=PoseFaults(**faults))
    return {
        'noise only': recorded(),
        'noisy orientation': lambda rng: pivoting(
            rng, SECONDS, RATE, noise=PoseNoise(orientation=np.radians(0.3))),
        '10 % wrong readings': recorded(wrong=0.1),
        'slip by 1.5 mm': recorded(slips=((12.0, 0.0015),)),
        'slip by 8 mm': recorded(slips=((12.0, 0.008),)),
        'three slips by 8 mm': recorded(slips=((3.0, 0.008), (7.0, 0.008), (16.0, 0.008))),
        'way to the divot': lambda rng: approaching(recorded()(rng)),
        JOINT: leg_swing,
    }


def approaching(recording: PivotRecording) -> PivotRecording:
    """Return a recording whose first fifth is a motion of 0.3 m to the divot."""
    from dataclasses import replace

    import numpy as np
    T = recording.T_tracker_body.copy()
    n = len(T) // 5
    T[:n, :3, 3] += np.linspace(0.3, 0.0, n)[:, None] * [0.0, 0.6, 0.8]
    return replace(recording, T_tracker_body=T)


def ours(recording: PivotRecording, joint: bool = False) -> Answer:
    """Return the tip, or the centre of the joint, that this package finds."""
    from time import perf_counter

    from gsdf_registration.tracking.pivot import calibrate_pivot, find_joint_centre
    find = find_joint_centre if joint else calibrate_pivot
    started = perf_counter()
    result = find(recording.T_tracker_body, recording.stamps)
    return result.point, perf_counter() - started


def peer_answers(recordings: list[PivotRecording]) -> tuple[dict[str, list[Answer]], str]:
    """Return the answers of each method of the peer, and why there are none, or an empty string."""
    import json
    import subprocess
    import tempfile
    from pathlib import Path

    import numpy as np

    from benchmarks.peers.environment import Group, clean_environment, environment
    from benchmarks.peers.peer_process import WORKERS
    group = Group('pivot', ('3.12', '3.11', '3.10'), ('setuptools<80', 'wheel', 'numpy'),
                  {LIBRARY: (f'{LIBRARY}==1.2.6',)})
    found = environment(group)
    if found.python is None or LIBRARY in found.missing:
        return {}, found.missing.get(LIBRARY, 'no Python')
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'poses.npz'
        poses: dict[str, Any] = {f'{i:06d}': each.T_tracker_body
                                 for i, each in enumerate(recordings)}
        np.savez(file, **poses)
        done = subprocess.run([found.python, WORKERS / 'pivots.py', file], env=clean_environment(),
                              capture_output=True, text=True, timeout=PEER_LIMIT)
    if done.returncode:
        return {}, (done.stderr.strip().splitlines() or ['no output'])[-1]
    return {method: [(None if tip is None else np.array(tip), seconds) for tip, seconds in answers]
            for method, answers in json.loads(done.stdout).items()}, ''


def row(scenario: str, method: str, recordings: list[PivotRecording],
        answers: list[Answer]) -> str:
    """Return the row of a method in a scenario; rejections have no error."""
    import numpy as np
    errors = [1e3 * float(np.linalg.norm(tip - recording.point))
              for (tip, _), recording in zip(answers, recordings) if tip is not None]
    rejected = len(answers) - len(errors)
    figures = [np.median(errors), np.percentile(errors, 95.0), max(errors)] if errors else []
    columns = ''.join(f'{figure:>10.2f}' if figure < 1e4 else f'{figure:>10.0e}'
                      for figure in figures) or f'{"-":>10}' * 3
    milliseconds = 1e3 * float(np.median([seconds for _, seconds in answers]))
    return f'{scenario:<24}{method:<24}{columns}{rejected:>10}{milliseconds:>8.1f}'
