# SPDX-License-Identifier: Apache-2.0
"""``gsdf show``: what RViz would show, as a picture file; needs no display."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import common
from gsdf_registration.common.result import ON_BONE, InputError, Refusal

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.common.samples import Points
    from gsdf_registration.field import Field
    from gsdf_registration.live.assessment import FullAssessment


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'show', help='draw bone, points and where to touch next into a PNG',
        description='Register what was touched and draw it: the bone coloured by the error to '
        'expect there, the points by how far off the bone they are, and where to touch next.',
        **common.example('gsdf show session.json --model hip.stl -o scene.png'))
    parser.add_argument('touched', metavar='WHAT',
                        help='a saved session (.json), a recording (rosbag2), or a file of points '
                        '(with --unit)')
    parser.add_argument('--model', required=True, metavar='MODEL',
                        help='STL, PLY, OBJ, OFF, a .gsdf field, or a point cloud with normals')
    parser.add_argument('--unit', choices=('mm', 'm'),
                        help='unit of the lengths in a file of points, and of the tracker columns '
                        'of --landmarks (of a recording: m)')
    parser.add_argument('-o', '--output', default='scene.png', metavar='OUT.png',
                        help='the picture (default: scene.png)')
    common.add_start_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Look at what was touched, draw it, say what it is worth; 1 if `register` would refuse it."""
    from gsdf_registration.live.assessment import survey
    from gsdf_registration.visualization.picture import require_matplotlib, write_picture
    from gsdf_registration.visualization.view import Scene
    require_matplotlib()
    config = common.effective_config(args)
    with common.busy('loading the bone'):
        field = common.field_or_refusal(config)
    if isinstance(field, Refusal):
        raise InputError(field.message)
    points, guess = _touched(args, field, config)
    with common.busy('looking where the bone is'):
        found = survey(points, field, config, None, 0, guess, (), lambda: False)
    no = found.rejection_reason
    verdict = _praise(found) if no is None else f'Refused: {no.message}'
    with common.busy('drawing'):
        write_picture(args.output, Scene(found, field, config.limits), verdict, no is None)
    print(f'{verdict}\n  picture        {args.output}')
    return 0 if no is None else 1


def _praise(found: FullAssessment) -> str:
    inliers = int((found.weights > ON_BONE).sum())
    return (f'Accepted: {inliers} of {len(found.weights)} points lie on the bone; expected error '
            f'{1e3 * found.predicted_tre_m["rms"]:.1f} mm (RMS) over the bone')


def _touched(args: argparse.Namespace, field: Field,
             config: Config) -> tuple[Points, Array | None]:
    """Return the points, and T_bone_tracker to look round, if anything tells of it."""
    import numpy as np

    from gsdf_registration.common.samples import Points
    from gsdf_registration.registration.pipeline import first_guess
    from gsdf_registration.session import Session
    from gsdf_registration.session.replay import collected
    from msg_adapters.points import read_points
    from msg_adapters.session_file import read_session

    path, T_tracker_bone = Path(args.touched), common.read_initial(args.initial)
    landmarks = common.read_landmark_pairs(args.landmarks, config.model.unit, args.unit or 'm')
    if path.suffix.lower() == '.json':
        session = Session(config, field)
        session.restore(read_session(path))
        pose = session.status().pose_result
        if T_tracker_bone is None and landmarks is None and pose is not None:
            T_tracker_bone = pose.T_tracker_bone
        points = session.points()
    elif path.is_dir() or path.suffix in ('.mcap', '.db3'):
        points = collected(common.read_recording(str(path), config), field, config).points()
    elif args.unit is None:
        raise InputError(f'{path}: say the unit of these points, --unit mm or --unit m')
    else:
        positions = read_points(path, args.unit).positions
        positions = positions[np.isfinite(positions).all(axis=1)]
        none = np.zeros(len(positions), np.int32)
        points = Points(positions, none.astype(np.float64), none, none)
    return points, first_guess(landmarks, T_tracker_bone)
