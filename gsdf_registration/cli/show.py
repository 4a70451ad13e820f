# SPDX-License-Identifier: Apache-2.0
"""``gsdf show``: write the RViz scene as a picture, or a report of a session; no display."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import inputs, landmark_files, options, session_report
from gsdf_registration.common.command_line import example, spinner
from gsdf_registration.common.result import INLIER_WEIGHT, InputError, Refusal

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.common.samples import Points
    from gsdf_registration.field import Field
    from gsdf_registration.live.assessment import FullAssessment


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'show', help='draw the bone, the points and the next touch as a PNG or a report',
        description='Register the points and draw the scene: the bone coloured by the expected '
        'error, the points by their distance from the bone, and the places to touch next.',
        **example('gsdf show session.json --model hip.stl -o scene.png'))
    parser.add_argument('points', metavar='POINTS',
                        help='a saved session (.json), a recording (rosbag2), or a file of points '
                        '(with --unit)')
    parser.add_argument('--model', required=True, metavar='MODEL', help=options.MODEL_HELP)
    parser.add_argument('--unit', choices=('mm', 'm'),
                        help='unit of the lengths in a file of points, and of the tracker columns '
                        'of --landmarks (default for a recording: m)')
    parser.add_argument('-o', '--output', default='scene.png', metavar='OUT.png',
                        help='file of the picture (default: scene.png)')
    options.add_start_options(parser)
    options.add_report_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Draw the scene, or write the report of a session; return 1 if the pose is rejected."""
    if args.report:
        return session_report.run(args)
    from gsdf_registration.live.assessment import assess_all_points
    from gsdf_registration.registration.evidence import Evidence
    from gsdf_registration.registration.landmark_evidence import for_tip
    from gsdf_registration.visualization.picture import require_matplotlib, write_picture
    from gsdf_registration.visualization.render import Scene
    require_matplotlib()
    config = inputs.effective_config(args)
    with spinner('loading the bone'):
        field = inputs.field_or_refusal(config)
    if isinstance(field, Refusal):
        raise InputError(field.message)
    points, landmarks, guess = _read_points(args, field, config)
    evidence = Evidence(for_tip(landmarks, field))
    with spinner('registering'):
        found = assess_all_points(points, field, config, guess=guess, evidence=evidence)
    reason = found.rejection_reason
    title = _accepted(found) if reason is None else f'Refused: {reason.message}'
    with spinner('drawing'):
        scene = Scene(field, config.limits, found.T_tracker_bone, found.covariance,
                      points.positions, found.residuals_m, found.weights, found.next_touches)
        write_picture(args.output, scene, title, reason is None)
    print(f'{title}\n  picture        {args.output}')
    return 0 if reason is None else 1


def _accepted(found: FullAssessment) -> str:
    inliers = int((found.weights > INLIER_WEIGHT).sum())
    assert found.zone is not None
    return (f'Accepted: {inliers} of {len(found.weights)} points lie on the bone; '
            f'{found.zone.sentence}')


def _read_points(args: argparse.Namespace, field: Field,
                 config: Config) -> tuple[Points, Landmarks, Array | None]:
    """Return points, landmarks, and the initial guess T_bone_tracker (4, 4), m, if any."""
    import numpy as np

    from gsdf_registration.common.landmarks import NO_LANDMARKS
    from gsdf_registration.common.samples import untimed
    from gsdf_registration.common.tool_pose import TIP_UNKNOWN
    from gsdf_registration.registration.input_checks import initial_guess
    from gsdf_registration.session import Session
    from gsdf_registration.session.replay import collected
    from msg_adapters.bag_storage import storage_name
    from msg_adapters.points import read_points
    from msg_adapters.session_file import read_session

    path, T_tracker_bone = Path(args.points), inputs.read_initial(args.initial)
    landmarks = landmark_files.read_landmark_files(args, config, args.unit or 'm')
    if path.suffix.lower() == '.json':
        session = Session(config, field)
        session.restore(read_session(path))
        pose = session.status().pose_result
        if T_tracker_bone is None and landmarks is None and pose is not None:
            T_tracker_bone = pose.T_tracker_bone
        points, landmarks = session.points(), landmarks or session.landmarks()
    elif path.is_dir() or storage_name(path):
        points = collected(inputs.read_recording(str(path), config), field, config).points()
    elif args.unit is None:
        raise InputError(f'{path}: the unit of the points is missing; add --unit mm or --unit m')
    else:
        axes = landmark_files.axes_of(args, config)
        recording = read_points(path, args.unit, axes=axes.tracker, poses=bool(config.probe.tip))
        if recording.tools is not None and not config.probe.tip:
            raise InputError(TIP_UNKNOWN)
        positions, _ = recording.tip_positions(config.probe.tip)
        positions = positions[np.isfinite(positions).all(axis=1)]
        points = untimed(positions)
    return points, landmarks or NO_LANDMARKS, initial_guess(landmarks, T_tracker_bone)
