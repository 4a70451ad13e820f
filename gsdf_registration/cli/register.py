# SPDX-License-Identifier: Apache-2.0
"""``gsdf register``: find the pose of a bone from the points in a file."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import inputs, landmark_files, options, outputs, pose_outputs
from gsdf_registration.common.command_line import example
from gsdf_registration.common.result import Reason, Refusal, RegistrationResult

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.common.samples import Points
    from gsdf_registration.field import Field
    from msg_adapters.recording import Recording


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'register', help='register points to a bone model',
        description='Find the pose of a bone from points that a probe touched on it.',
        **example('gsdf register hip.stl points.csv --unit mm --landmarks landmarks.csv '
                  '--json pose.json'))
    parser.add_argument('model', metavar='MODEL', help=options.MODEL_HELP)
    parser.add_argument('points', metavar='POINTS',
                        help='CSV with the header x,y,z, or tx,ty,tz,qx,qy,qz,qw for poses of a '
                        'tool; an NDI tracker CSV; PLY or XYZ; a point list of Slicer (.mrk.json, '
                        '.fcsv)')
    parser.add_argument('--unit', choices=('mm', 'm'), required=True,
                        help='unit of the lengths in POINTS')
    parser.add_argument('--tool', metavar='NAME',
                        help='part of the port label, if an NDI tracker CSV has several tools')
    options.add_registration_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Register, print and write the result; return 1 if it is rejected."""
    from gsdf_registration.cli.result_json import result_to_json
    from gsdf_registration.cli.summary import summary
    from gsdf_registration.common.landmarks import NO_LANDMARKS
    from gsdf_registration.common.samples import untimed
    from gsdf_registration.visualization.report_content import ReportContent
    from msg_adapters.files import sha256_of
    from msg_adapters.points import read_points

    outputs.require_report(args.report)
    pose_outputs.check_pose_outputs(args)
    config = inputs.effective_config(args)
    inputs.prepare_kernels(config)
    started = time.perf_counter()
    T_tracker_bone = inputs.read_initial(args.initial)
    axes = landmark_files.axes_of(args, config)
    landmarks = landmark_files.read_landmark_files(args, config, args.unit)
    recording = read_points(args.points, args.unit, args.tool, axes.tracker,
                            poses=bool(config.probe.tip))
    for note in recording.notes:
        print(f'note: {note}', file=sys.stderr)
    field = inputs.field_or_refusal(config)
    loaded = time.perf_counter()
    points = untimed(recording.positions)
    if isinstance(field, Refusal):
        bone, result = None, RegistrationResult.refused(field.reason, field.message)
    else:
        bone = field
        landmark_files.check_axes(landmarks, bone, axes)
        result, points = register_recording(recording, bone, config, landmarks, T_tracker_bone)
    document = result_to_json(
        result, config, frame_id=config.probe.frame_id,
        model_sha256=bone.bone_sha256 if bone else None, points_sha256=sha256_of(args.points),
        load_s=loaded - started, total_s=time.perf_counter() - started)
    outputs.write_json(args.json, document)
    pose_outputs.PoseOutputs.of(args, axes).write(result, config, config.probe.frame_id,
                                                  points.positions, landmarks)
    outputs.write_report(args.report, ReportContent(
        f'{Path(args.model).name} from {Path(args.points).name}', result, config, bone, points,
        timed=recording.stamps is not None and bone is not None,
        landmarks=landmarks or NO_LANDMARKS, case=args.case, date=outputs.day_of(points.stamps),
        axes=axes.model,
        about=outputs.about_inputs(args.model, args.points, document)))
    print(summary(result, config.probe.frame_id),
          file=sys.stderr if args.json == '-' else sys.stdout)
    return 0 if result.success else 1


def register_recording(
        recording: Recording, field: Field, config: Config, landmarks: Landmarks | None,
        T_tracker_bone: Array | None) -> tuple[RegistrationResult, Points]:
    """
    Register the points of a file: through a session, as in the node, if they have stamps.

    Return also the points that were registered.
    """
    import numpy as np

    from gsdf_registration.common.samples import Rejection, untimed
    from gsdf_registration.common.tool_pose import TIP_UNKNOWN
    from gsdf_registration.registration.pipeline import register
    from gsdf_registration.session.replay import replay

    if recording.stamps is None:
        if recording.tools is not None and not config.probe.tip:
            refusal = RegistrationResult.refused(Reason.BAD_INPUT, TIP_UNKNOWN, len(recording))
            return _counted(refusal, recording.dropped), untimed(recording.positions)
        positions, bad = recording.tip_positions(config.probe.tip)
        finite = np.isfinite(positions).all(axis=1)
        points = positions[finite]
        result = register(points, field, config, landmarks=landmarks, T_tracker_bone=T_tracker_bone)
        rejected = {str(Rejection.NOT_FINITE): int((~finite).sum()) - bad,
                    str(Rejection.BAD_QUATERNION): bad, **recording.dropped}
        return _counted(result, rejected), untimed(points)
    # files of points do not name a frame
    recording.frame_ids = [config.probe.frame_id] * len(recording)
    result, session = replay(recording, field, config, landmarks, T_tracker_bone)
    return result, session.points()


def _counted(result: RegistrationResult, rejected: dict[str, int]) -> RegistrationResult:
    """Return a result that also counts samples which were rejected before it."""
    return dataclasses.replace(result, received=result.received + sum(rejected.values()),
                               rejected=rejected)
