# SPDX-License-Identifier: Apache-2.0
"""``gsdf replay``: register recordings offline, with the same session as the node."""

from __future__ import annotations

import argparse
import multiprocessing
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import inputs, landmark_files, options, outputs, pose_outputs
from gsdf_registration.common.command_line import example, positive_number
from gsdf_registration.common.result import InputError, Refusal, RegistrationResult

if TYPE_CHECKING:
    from gsdf_registration.cli.pose_outputs import PoseOutputs
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.session.operator_replay import Settle


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'replay', help='register recordings (rosbag2, ROS 1) offline',
        description='Process each recording in the same session as the ROS node does, without '
        'ROS, and register. If the recording has the events of the node (~/events), what the '
        'operator did is carried out again, with the settings of the node unless others are '
        'given. If a YAML file with the ground truth has the same name as the bag, '
        'the true error is printed.',
        **example('gsdf replay bags/hip_optical --model bags/hip.ply '
                  '--landmarks bags/hip_optical.yaml'))
    parser.add_argument('bags', metavar='BAG', nargs='+',
                        help='rosbag2 directory, its .mcap or .db3 file, or a .bag of ROS 1')
    parser.add_argument('--model', required=True, metavar='MODEL', help=options.MODEL_HELP)
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
                        '(default: the only topic that ends with /events)')
    parser.add_argument('--jobs', type=positive_number, default=1, metavar='N',
                        help='number of recordings processed in parallel (default: 1)')
    options.add_registration_options(parser)
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class Job:
    """The arguments that all bags share."""

    config: Config
    settle: Settle              # the settings in place of those of a recorded node
    topics: list[str] | None
    events: str | None          # topic; empty: none; None: the only one
    landmarks: Landmarks | None
    T_tracker_bone: Array | None
    field: Field | Refusal      # a refusal if the model is not as large as a bone
    load_s: float               # time to load the model
    report: str | None          # file of the HTML report
    case: str                   # label of the case in it
    axes: str                   # of the model, 'lps' or 'ras'
    outputs: PoseOutputs        # files of the pose


@dataclass(frozen=True)
class Outcome:
    """The result for one bag: exit code, JSON document and text to print."""

    status: int
    document: dict[str, Any]
    text: str


def run(args: argparse.Namespace) -> int:
    """Replay every bag; return the largest exit code."""
    several = len(args.bags) > 1
    if several and args.report:
        raise InputError('--report describes one recording; give one BAG or leave out --report')
    outputs.require_report(args.report)
    pose_outputs.check_pose_outputs(args, several)
    config = inputs.effective_config(args)
    inputs.prepare_kernels(config)
    axes = landmark_files.axes_of(args, config)
    landmarks = landmark_files.read_landmark_files(args, config, args.unit)
    T_tracker_bone = inputs.read_initial(args.initial)
    started = time.perf_counter()
    field = inputs.field_or_refusal(config)
    if not isinstance(field, Refusal):
        landmark_files.check_axes(landmarks, field, axes)
    job = Job(config, partial(inputs.effective_config, args), args.topic,
              '' if args.events == 'none' else args.events, landmarks, T_tracker_bone, field,
              time.perf_counter() - started, args.report, args.case, axes.model,
              pose_outputs.PoseOutputs.of(args, axes))
    outcomes = []
    for bag, outcome in zip(args.bags, _outcomes(args.bags, job, args.jobs)):
        failed = outcome.status == 2
        if failed and not several:
            raise InputError(outcome.text)
        prefix = 'gsdf: error: ' if failed else f'{bag}: ' if several else ''
        print(prefix + outcome.text, flush=True,
              file=sys.stderr if failed or args.json == '-' else sys.stdout)
        outcomes.append(outcome)
    documents = [outcome.document for outcome in outcomes]
    outputs.write_json(args.json, documents if several else documents[0])
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
    """Replay one bag; unreadable input is an outcome, too."""
    from gsdf_registration.cli.result_json import result_to_json
    from gsdf_registration.cli.session_report import content_of, content_of_refusal
    from gsdf_registration.cli.summary import summary, true_error
    from gsdf_registration.common.formatting import format_count
    from gsdf_registration.session.replay import replay_events
    from msg_adapters.files import sha256_of
    from msg_adapters.truth import read_truth, truth_path

    started = time.perf_counter()
    try:
        recording = inputs.read_recording(bag, job.config, job.topics, job.events)
        config = inputs.config_of(recording, job.config, job.settle)
        truth = read_truth(truth_path(bag)) if truth_path(bag).is_file() else None
    except InputError as error:
        refused = RegistrationResult.refused(error.reason, error.message)
        return Outcome(2, result_to_json(refused, job.config), error.message)
    loaded = time.perf_counter()
    frame_id, points, error_text = '', recording.positions, ''
    notes = recording.notes
    if isinstance(job.field, Refusal):
        bone, result = None, RegistrationResult.refused(job.field.reason, job.field.message)
    else:
        bone = job.field.for_tip(config.probe.tip_radius)
        replayed = replay_events(recording, bone, job.settle, job.landmarks, job.T_tracker_bone)
        result, session, notes = replayed.result, replayed.session, (*notes, *replayed.notes)
        points, frame_id = session.points().positions, session.status().frame_id or ''
        if truth is not None and frame_id in ('', truth.frame_id):
            error_text = true_error(result, bone, truth.T_tracker_bone)
    for note in notes:
        print('note:', note if bag in note else f'{bag}: {note}', file=sys.stderr)
    if notes:
        remark = ('the recording is not complete' if not recording.complete
                  else f'see the {format_count(len(notes), "note")} on the recording')
        result = replace(result, message=f'{result.message}; {remark}')
    document = result_to_json(
        result, config, frame_id=frame_id, points_sha256=sha256_of(bag),
        model_sha256=bone.bone_sha256 if bone else None,
        recording={'complete': recording.complete, 'notes': notes},
        load_s=job.load_s + loaded - started, total_s=job.load_s + time.perf_counter() - started)
    job.outputs.write(result, config, frame_id, points, job.landmarks)
    if job.report is not None:
        remarks = {f'note {number}': note for number, note in enumerate(notes, 1)}
        about = outputs.about_inputs(config.model.path, bag, document)
        complete = 'complete' if recording.complete else 'NOT complete'
        common: dict[str, Any] = {
            'title': f'{Path(config.model.path).name} from {Path(bag).name}',
            'case': job.case, 'axes': job.axes,
            'about': {**about, 'recording': complete, **remarks,
                      'true error': error_text or 'not known'}}
        outputs.write_report(job.report, content_of_refusal(result, config, points, **common)
                             if bone is None else content_of(
                                 session, result, config, bone, landmarks=job.landmarks,
                                 **common))
    rows = [('true error', error_text)] if error_text else []
    return Outcome(0 if result.success else 1, document, summary(result, frame_id, rows))
