# SPDX-License-Identifier: Apache-2.0
"""``gsdf bench paper``: the published experiments anew, beside other libraries."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.bones import about, add_bones_option, bones
from gsdf_registration.cli.common import busy, example
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.cases import Case
    from benchmarks.paper import Method

SEED = 1000         # the settings of the peers were chosen on trials with the seeds 0 and 1
CAPTION = """\
# The published experiments anew

{bones} bones, {cases} cases, {trials} seeds a case and scenario (dear methods: fewer, see the
column "trials"); 600 to 1000 points in strokes, rotations of up to 45 degrees about each axis,
translations of up to 1 m. {machine}.

*gsdf* is the whole pipeline, given nothing but the points. Of the others, those with the start
"landmarks" are given a pose from three landmarks, each touched 4 mm off; "centroids": the
centroid of the points laid on that of the bone, unturned, as published; "none": they search for
themselves, and an ICP (Open3D, point-to-plane, Tukey) follows. All others get the points after
the same density filter and are told the noise. Each runs in a process of its own, one thread,
with its model prepared beforehand, and is stopped after {limit:.0f} s.

The peers' settings are the best of a few tried by hand, on trials with other seeds; ours are the
defaults.

Errors are means over all poses given; a success is a pose within {far:.0f} mm RMS over the whole
bone. What is refused, failed or timed out is none. A wrong claim is a pose of ours off by more
than that, or than 1 mm + 3 times what it predicts of itself. Times are medians; lengths in mm,
angles in degrees."""


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'paper',
        help="the paper's tables anew, beside other libraries",
        description="Make the paper's tables anew on the bones of a folder, one of structured "
        'interference, and one of a model that is off, beside ICPs, CPD, JRMPC, Go-ICP, TEASER++ '
        'and more, which are installed into environments of their own at the first run. Trials '
        'already in DIR are not run again.',
        **example('gsdf bench paper --bones ~/bones --output paper'))
    add_bones_option(parser)
    parser.add_argument('--trials', type=int, default=2, metavar='N',
                        help='seeds a case and scenario (default: 2)')
    parser.add_argument('--seed', type=int, default=SEED, metavar='N',
                        help=f'of the first round (default: {SEED})')
    parser.add_argument('--methods', metavar='NAME,...', default='*',
                        help='only these; * stands for any letters (default: all)')
    parser.add_argument('--tables', metavar='NAME,...', default='*',
                        help='only these of regions, noise, outliers, structured, model '
                        '(default: all)')
    parser.add_argument('--output', '-o', metavar='DIR', default='paper',
                        help='folder for trials.tsv, figures.tsv, tables.md and plots.html '
                        '(default: paper)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run what is missing, write the tables, print them."""
    from benchmarks import paper
    from benchmarks.cases import find_cases
    from benchmarks.runner import run_all
    from benchmarks.tables import markdown, tsv
    from gsdf_registration.common.config import Config
    from gsdf_registration.visualization import require_plotly
    from msg_adapters.files import write_atomically

    require_plotly()
    if args.trials < 1 or args.seed < 0:
        raise InputError('--trials must be at least 1 and --seed must not be negative')
    methods = [paper.METHODS[name] for name in chosen(args.methods, paper.METHODS, 'method')]
    scenarios = list(dict.fromkeys(scenario for name in chosen(args.tables, paper.TABLES, 'table')
                                   for scenario in paper.TABLES[name]))
    found = find_cases(bones(args.bones))
    pythons, missing = environments(methods)
    config = Config().replaced({'search.threads': 1})
    output = Path(args.output)
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        jobs = {f'{method.name}/{trial.name}': paper.Job(method, trial, pythons[method.name],
                                                         Path(folder), config)
                for method, trial in paper.questions(
                    [method for method in methods if method.name not in missing], found,
                    scenarios, args.trials, args.seed)}
        rows = run_all(jobs, paper.attempt, output=output / 'trials.tsv',
                       about=about(found, args.seed, config))
    text = markdown(rows, missing, caption(found, args.trials))
    write_atomically(output / 'figures.tsv', tsv(rows))
    write_atomically(output / 'tables.md', text)
    from benchmarks.plots import page
    write_atomically(output / 'plots.html', page(rows))
    print(text)
    return 0


def chosen(text: str, known: Sequence[str] | dict[str, Any], what: str) -> list[str]:
    """Return those of the known names that a list of names or patterns speaks of."""
    from fnmatch import fnmatchcase
    words = text.split(',')
    for word in words:
        if not any(fnmatchcase(name, word) for name in known):
            raise InputError(f'{what} "{word}" is not known; say one of {", ".join(known)}')
    return [name for name in known if any(fnmatchcase(name, word) for word in words)]


def environments(methods: Sequence[Method]) -> tuple[dict[str, Path], dict[str, str]]:
    """Return the Python of each method, and of those that are not to be had the reason."""
    from benchmarks.peers.catalogue import PEERS
    from benchmarks.peers.environment import environment
    groups = {PEERS[m.peer].group.name: PEERS[m.peer].group for m in methods if m.peer}
    made = {}
    for name, group in groups.items():
        with busy(f'environment of the peers, {name}'):
            made[name] = environment(group)
    pythons, missing = {}, {}
    for method in methods:
        if not method.peer:
            pythons[method.name] = Path(sys.executable)
            continue
        peer = PEERS[method.peer]
        there = made[peer.group.name]
        if there.python is None or peer.library in there.missing:
            missing[method.name] = there.missing[peer.library]
        else:
            pythons[method.name] = there.python
    return pythons, missing


def caption(found: list[Case], trials: int) -> str:
    """Say what was done, on what."""
    from benchmarks.peers.caller import LIMIT
    from benchmarks.scoring import FAR
    return CAPTION.format(
        bones=len({case.bone for case in found}), cases=len(found), trials=trials, limit=LIMIT,
        far=1e3 * FAR, machine=f'{platform.machine()}, {os.cpu_count()} cores, '
        f'Python {platform.python_version()}')
