# SPDX-License-Identifier: Apache-2.0
"""``gsdf replay``: register recordings offline, with the same session as the node."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from typing import Any

from gsdf_registration.cli import archive, archive_run, inputs, options, outputs, pose_outputs
from gsdf_registration.cli.replay_bag import Outcome, replay_bag
from gsdf_registration.common.command_line import example, positive_number
from gsdf_registration.common.result import InputError, Reason, RegistrationResult

OF_ARCHIVE = ('scheduler', 'sweep', 'cases')    # options that need --output
EXAMPLES = (
    'gsdf replay bags/hip_optical --model bags/hip.ply --landmarks bags/hip_optical.yaml',
    "gsdf replay 'archive/**/*.mcap' --model hip.stl --jobs 8 --report --output release_2",
    'gsdf replay --cases cases.csv --sweep solver.method=mixture,paper --output methods',
)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'replay', help='register recordings (rosbag2, ROS 1) offline',
        description='Process each recording in the same session as the ROS node does, without '
        'ROS, and register. If the recording has the events of the node (~/events), what the '
        'operator did is carried out again, with the settings of the node unless others are '
        'given. If a YAML file with the ground truth has the same name as the bag, '
        'the true error is printed. With --output the results of an archive are a table and a '
        'page, and a run that was stopped is continued.', **example(*EXAMPLES))
    parser.add_argument('bags', metavar='BAG', nargs='*',
                        help='rosbag2 directory, its .mcap or .db3 file, or a .bag of ROS 1; a '
                        'folder of recordings; or a quoted pattern, ** for any folders')
    parser.add_argument('--model', metavar='MODEL', help=options.MODEL_HELP)
    parser.add_argument('--unit', choices=('mm', 'm'), default='m',
                        help='unit of --tip, --tip-radius and the tracker columns of --landmarks '
                        '(default: m, as in bags)')
    parser.add_argument('--topic', action='append', metavar='T',
                        help='topic of the probe: positions of its tip, or poses of the tool; may '
                        'be repeated')
    parser.add_argument('--reference', metavar='T',
                        help='topic of the poses of the reference array (default: '
                        'reference.topic)')
    parser.add_argument('--events', metavar='T',
                        help='topic of what the operator did, or "none" to register all points '
                        '(default: the only topic that ends with /events); or the node whose '
                        'services were introspected (default: the only one)')
    parser.add_argument('--jobs', type=positive_number, metavar='N',
                        help='number of recordings processed in parallel (default: 1)')
    parser.add_argument('--mcap', metavar='OUT',
                        help='also record what the node would publish (rosbag2, mcap), to be '
                        'opened in Foxglove, rerun or RViz')
    _add_archive_options(parser)
    options.add_registration_options(parser, archive=True)
    parser.set_defaults(run=run)


def _add_archive_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of an archive."""
    parser.add_argument('-o', '--output', metavar='DIR',
                        help='folder of the results of an archive: tables, a page, the JSON and, '
                        'with --report, the report of each recording; recordings whose results '
                        'are there are not registered again')
    parser.add_argument('--scheduler', metavar='ADDRESS',
                        help='register on a Dask cluster, as tcp://HOST:8786 (extra "dask"); its '
                        'workers need the recordings and DIR under the same paths')
    parser.add_argument('--cases', metavar='CSV',
                        help='table of the recordings, with the columns bag and, in place of the '
                        'options, model, landmarks, config, label')
    parser.add_argument('--sweep', action='append', metavar='NAME=VALUE,...',
                        help='register each recording with each of these values of a setting; may '
                        'be repeated, for all combinations')


def run(args: argparse.Namespace) -> int:
    """Replay every bag; return the largest exit code."""
    if args.output is not None:
        pose_outputs.check_pose_outputs(args, several=True)
        _check_recorded(args, several=True)
        if args.json:
            raise InputError('--json: with --output the results are in files of their own')
        return archive_run.run(args)
    needs = next((name for name in OF_ARCHIVE if getattr(args, name)), None)
    if needs:
        raise InputError(f'--{needs} needs --output DIR, the folder for the results')
    if not args.bags or not args.model:
        raise InputError('give the recordings and their bone: BAG... --model MODEL')
    bags = archive.find_bags(args.bags)
    _check_outputs(args, several=len(bags) > 1)
    config = inputs.effective_config(args)
    inputs.prepare_kernels(config)
    inputs.timed_field(config)      # an error of the model is no error of a recording
    outcomes = []
    for bag, outcome in zip(bags, _outcomes(bags, args)):
        _print(bag, outcome, args, several=len(bags) > 1)
        outcomes.append(outcome)
    documents = [outcome.document for outcome in outcomes]
    outputs.write_json(args.json, documents if len(bags) > 1 else documents[0])
    return max(outcome.status for outcome in outcomes)


def _check_outputs(args: argparse.Namespace, several: bool) -> None:
    """Raise `InputError` if a file cannot be written as it is asked for."""
    if args.report == '':
        raise InputError('--report needs a name, OUT.html, or --output DIR for all reports')
    if several and args.report:
        raise InputError('--report describes one recording; give one BAG, or --output DIR for '
                         'the reports of all')
    outputs.require_report(args.report)
    pose_outputs.check_pose_outputs(args, several)
    _check_recorded(args, several)


def _check_recorded(args: argparse.Namespace, several: bool) -> None:
    """Raise `InputError` if the topics of the node cannot be recorded as it is asked for."""
    if args.mcap and several:
        raise InputError('--mcap records one session; give one BAG, without --output')
    if args.mcap and os.path.exists(args.mcap):
        raise InputError(f'--mcap: {args.mcap} exists already; remove it or choose another path')


def _print(bag: str, outcome: Outcome, args: argparse.Namespace, several: bool) -> None:
    """Print an outcome and its notes; raise `InputError` if the only bag cannot be read."""
    failed = outcome.status == 2
    if failed and not several:
        raise InputError(outcome.text)
    for note in outcome.notes:
        print('note:', note if bag in note else f'{bag}: {note}', file=sys.stderr)
    prefix = 'gsdf: error: ' if failed else f'{bag}: ' if several else ''
    print(prefix + outcome.text, flush=True,
          file=sys.stderr if failed or args.json == '-' else sys.stdout)


def _outcomes(bags: list[str], args: argparse.Namespace) -> Iterator[Outcome]:
    """Yield the outcome of each bag, in their order."""
    workers = min(args.jobs or 1, len(bags))
    if workers == 1:
        yield from (replay_bag(bag, args) for bag in bags)
        return
    from gsdf_registration.common.process_pool import Died, run_processes, threads_each
    own = argparse.Namespace(**{name: value for name, value in vars(args).items()
                                if name != 'run'})
    work = partial(replay_bag, args=own, threads=threads_each(workers))
    waiting, following = dict[int, Outcome](), 0
    with closing(run_processes(work, bags, workers)) as answers:
        for number, answer in answers:
            waiting[number] = (_died(bags[number], args) if isinstance(answer, Died) else answer)
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def _died(bag: str, args: argparse.Namespace) -> Outcome:
    """Return the outcome of a bag whose process died."""
    from gsdf_registration.cli.result_json import result_to_json
    message = f'{bag}: {archive_run.DIED}'
    refused = RegistrationResult.refused(Reason.BAD_INPUT, message)
    return Outcome(2, result_to_json(refused, inputs.effective_config(args)), message)
