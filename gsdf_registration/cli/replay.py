# SPDX-License-Identifier: Apache-2.0
"""``gsdf replay``: recordings through the same session as the node's, offline."""

from __future__ import annotations

import argparse
import multiprocessing
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import common
from gsdf_registration.common.result import InputError, Refusal, RegistrationResult

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.session import LandmarkPairs


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'replay',
        help='register recordings (rosbag2) offline',
        description=
        'Put each recording through the same session as the ROS node does, without ROS, and '
        'register. Where the ground truth lies beside a bag (YAML of the same name), the true '
        'error is told.',
        **common.example('gsdf replay bags/hip_optical --model bags/hip.ply '
                         '--landmarks bags/hip_optical.yaml'))
    parser.add_argument('bags',
                        metavar='BAG',
                        nargs='+',
                        help='rosbag2 directory, or its .mcap or .db3 file')
    parser.add_argument('--model', required=True, metavar='MODEL',
                        help='STL, PLY, OBJ, OFF, a .gsdf field, or a point cloud with normals')
    parser.add_argument('--unit', choices=('mm', 'm'), default='m',
                        help='unit of the tracker columns of --landmarks (default: m, as in bags)')
    parser.add_argument('--topic',
                        action='append',
                        metavar='T',
                        help='topic of the tip; may be repeated')
    parser.add_argument('--jobs', type=_positive, default=1, metavar='N',
                        help='recordings worked on at a time (default: 1)')
    common.add_registration_options(parser)
    parser.set_defaults(run=run)


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError('must be 1 or more')
    return number


@dataclass(frozen=True)
class Job:
    """What is done with every bag."""

    config: Config
    topics: list[str] | None
    landmarks: LandmarkPairs | None
    T_tracker_bone: Array | None
    field: Field | Refusal      # the bone, or why its size is not a bone's
    load_s: float               # time it took to load
    report: str | None          # where a page goes, if one is wanted


@dataclass(frozen=True)
class Outcome:
    """What came of one bag: the exit status, the JSON document and the lines for the reader."""

    status: int
    document: dict[str, Any]
    text: str


def run(args: argparse.Namespace) -> int:
    """Replay every bag; the status of the worst one."""
    several = len(args.bags) > 1
    if several and args.report:
        raise InputError('--report is the page of one recording: give one BAG, or leave it out')
    common.require_report(args.report)
    config = common.effective_config(args)
    landmarks = common.read_landmark_pairs(args.landmarks, config.model.unit, args.unit)
    T_tracker_bone = common.read_initial(args.initial)
    started = time.perf_counter()
    field = common.field_or_refusal(config)
    job = Job(config, args.topic, landmarks, T_tracker_bone, field, time.perf_counter() - started,
              args.report)
    outcomes = []
    for bag, outcome in zip(args.bags, _outcomes(args.bags, job, args.jobs)):
        failed = outcome.status == 2
        if failed and not several:
            raise InputError(outcome.text)
        told = 'gsdf: error: ' if failed else f'{bag}: ' if several else ''
        print(told + outcome.text,
              file=sys.stderr if failed or args.json == '-' else sys.stdout,
              flush=True)
        outcomes.append(outcome)
    documents = [outcome.document for outcome in outcomes]
    common.write_json(args.json, documents if several else documents[0])
    return max(outcome.status for outcome in outcomes)


def _outcomes(bags: list[str], job: Job, jobs: int) -> Iterator[Outcome]:
    replay_one = partial(replay_bag, job=job)
    if jobs == 1 or len(bags) == 1:
        yield from map(replay_one, bags)
        return
    # spawned, not forked: compiled kernels and their threads do not survive a fork
    pool = ProcessPoolExecutor(min(jobs, len(bags)), multiprocessing.get_context('spawn'),
                               initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))
    try:
        yield from pool.map(replay_one, bags)
    finally:
        pool.shutdown(cancel_futures=True)


def replay_bag(bag: str, job: Job) -> Outcome:
    """Replay one bag, whatever comes of it."""
    from gsdf_registration.cli.result_json import result_to_json
    from gsdf_registration.cli.summary import summary, true_error
    from gsdf_registration.session.replay import replay
    from msg_adapters.truth import read_truth, truth_path

    started = time.perf_counter()
    try:
        recording = common.read_recording(bag, job.config, job.topics)
        truth = read_truth(truth_path(bag)) if truth_path(bag).is_file() else None
    except InputError as error:
        refused = RegistrationResult.refused(error.reason, error.message)
        return Outcome(2, result_to_json(refused, job.config), error.message)
    loaded = time.perf_counter()
    frame_id, points, rejected, against_truth = '', recording.positions, {}, ''
    if isinstance(job.field, Refusal):
        bone, result = None, RegistrationResult.refused(job.field.reason, job.field.message)
    else:
        bone = job.field
        result, session = replay(recording, bone, job.config, job.landmarks, job.T_tracker_bone)
        status, points = session.status(), session.points().positions
        frame_id, rejected = status.frame_id or '', status.rejected
        if truth is not None and frame_id in ('', truth.frame_id):
            against_truth = true_error(result, bone, truth.T_tracker_bone)
    document = result_to_json(
        result, job.config, frame_id=frame_id, points_sha256=common.sha256_of(bag),
        model_sha256=bone.bone_sha256 if bone else None,
        load_s=job.load_s + loaded - started, total_s=job.load_s + time.perf_counter() - started)
    common.write_report(job.report, result, bone, points, document, {
        'model': job.config.model.path, 'recording': bag,
        'frame of the points': frame_id or 'not known',
        'not believed': common.counts_by_cause(rejected) or 'none',
        'true error': against_truth or 'not known'})
    told = summary(result, frame_id, rejected)
    if against_truth:
        told += f'\n  true error     {against_truth}'
    return Outcome(0 if result.success else 1, document, told)
