# SPDX-License-Identifier: Apache-2.0
"""``gsdf simulate``: record a simulated probe on a bone as a bag, with its ground truth."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import options, simulate_tool
from gsdf_registration.cli import simulation_options as given
from gsdf_registration.common.command_line import example, number, whole_number
from gsdf_registration.common.formatting import format_count

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.simulation.moving import Sway
    from gsdf_registration.simulation.probe import SimulatedRecording
    from gsdf_registration.simulation.touched_bone import TouchedBone

REGIONS = ('acetabulum', 'proximal_femur', 'condyles', 'proximal_tibia')
# options that the ground truth records
ABOUT = ('region', 'points', 'rate', 'speed', 'sigma', 'distortion', 'outliers', 'interference',
         'dropouts', 'seed')
# the array that moves with the patient
ARRAY_TOPIC, ARRAY_RATE = '/reference/pose', 80.0   # Hz
EXAMPLES = (
    'gsdf simulate hip.ply --region acetabulum --points 600 --outliers 0.05 -o hip_bag',
    'gsdf simulate femur.ply --region=-25,0,20,38 --rate 40 --sigma 0.4 -o femur_bag',
    'gsdf simulate hip.ply --region acetabulum --move 20,10 -o moving_bag',
    'gsdf simulate femur.ply --region condyles --tool-poses --tip-radius 1 --pivoting 12 '
    '--swinging 15 -o knee_bag',
)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'simulate', help='record a simulated probe on a bone, with its ground truth',
        description='Simulate a probe that is dragged over a bone. The recording is a rosbag2 '
        '(mcap), the ground truth a YAML file of the same name. The same arguments give the same '
        'bytes.',
        **example(*EXAMPLES))
    add = parser.add_argument
    add('model', metavar='MODEL', help='mesh or segmentation of the bone')
    add('--region', required=True, metavar='NAME|X,Y,Z,RADIUS',
        help=f'the exposed area: {", ".join(REGIONS)}, or a ball in units of the model')
    add('-o', '--output', required=True, metavar='BAG', help='directory of the new bag')
    options.add_model_options(parser)
    add('--points', type=whole_number, default=600, metavar='N',
        help='samples on the bone, without interference (default: %(default)s)')
    add('--rate', type=number, default=80.0, metavar='HZ',
        help='sampling rate of the tracker (default: %(default)s)')
    add('--speed', type=number, default=27.0, metavar='MM/S',
        help='median speed of the tip (default: %(default)s)')
    add('--sigma', default='0.15', metavar='MM|X,Y,Z',
        help='noise per axis of the tracker (default: %(default)s)')
    add('--distortion', type=number, default=0.0, metavar='MM',
        help='smooth distortion (RMS), as of an electromagnetic tracker (default: none)')
    add('--outliers', type=number, default=0.0, metavar='SHARE',
        help='share of outliers, uniform in the bounding box of the model (default: none)')
    add('--interference', default='', metavar='KIND:SHARE,...',
        help='share of each kind: soft_tissue, lift_off, other_object, resting')
    add('--dropouts', type=number, default=0.0, metavar='SHARE',
        help='share of the samples on the bone that the tracker does not report (default: none)')
    add('--gaps', type=number, default=0.0, metavar='N',
        help='gaps of 125 ms per minute, in which the tracker reports nothing (default: none)')
    add('--landmark', action='append', default=[], metavar='NAME=X,Y,Z',
        help='a model point that is touched first, with an error of 2 to 4 mm; may be repeated')
    add('--unsteadiness', type=number, default=0.5, metavar='S',
        help='standard deviation of the logarithm of the speed (default: %(default)s)')
    add('--stroke', type=number, default=45.0, metavar='MM',
        help='mean length of a stroke (default: %(default)s)')
    add('--pause', default='0.6,1.5', metavar='S,S',
        help='shortest and longest pause between strokes (default: %(default)s)')
    add('--tip-radius', type=number, default=0.0, metavar='MM',
        help='radius of the ball at the end of the probe (default: a sharp tip)')
    add('--cartilage', action='store_true',
        help='cover a part of the exposed area with 0.8 mm of cartilage')
    add('--soft-tissue', type=number, default=0.0, metavar='MM',
        help='mean thickness of soft tissue on the whole exposed area (default: none)')
    add('--move', default='', metavar='MM/S,DEG/S',
        help='speed at which the patient moves and turns; adds a reference array with poses on '
        f'{ARRAY_TOPIC}, and the ground truth is in its frame (default: no motion, no array)')
    add('--frame-id', default='tracker', metavar='FRAME',
        help='frame of the points (default: %(default)s)')
    add('--seed', type=whole_number, default=0, metavar='N',
        help='of the random numbers (default: %(default)s)')
    simulate_tool.add_options(parser)
    parser.set_defaults(run=run, model_unit='mm')


def run(args: argparse.Namespace) -> int:
    """Simulate, write bag and ground truth, print a summary."""
    from gsdf_registration.common.rigid import transform
    from msg_adapters.truth import truth_path

    bone = given.touched_bone(args)
    names, places = given.landmarks(args)
    if args.tool_poses:
        return simulate_tool.run(args, bone, names, places)
    simulate_tool.refuse_options(args)
    touched, recording = _simulate(args, bone, places)
    sway = given.sway(args, transform(recording.T_tracker_bone, bone.patch.centre))
    _write_bag(args, touched, recording, sway)
    _write_truth(args, touched, recording, sway, names, places)
    print(f'{args.output}: {len(recording.stamps)} points in {recording.stamps[-1]:.1f} s, '
          f'{int(recording.on_bone.sum())} of them on the bone, '
          f'{format_count(len(names), "landmark")}; ground truth in {truth_path(args.output)}')
    return 0


def _simulate(args: argparse.Namespace, bone: TouchedBone,
              places: Array) -> tuple[SimulatedRecording, SimulatedRecording]:
    """Return the recordings of the landmarks (k, 3), m, bone frame, and of the exposed area."""
    import numpy as np

    from gsdf_registration.simulation.losses import Losses, received
    from gsdf_registration.simulation.probe import simulate_landmarks, simulate_scan

    rng = np.random.default_rng(given.at_least(0, args.seed, '--seed'))
    settings: dict[str, Any] = {'tracker': given.tracker(args, rng),
                                'T_tracker_bone': given.bone_pose(bone, rng)}
    touched = simulate_landmarks(places, rng, **settings)
    recording = simulate_scan(bone.patch, given.at_least(30, args.points, '--points'), rng,
                              interference=given.interference(args), hand=given.hand(args),
                              **settings)
    recording = bone.touched(recording, rng)
    if args.gaps:   # drop-outs are those of the strokes
        gaps = Losses(gaps=given.losses(args).gaps)
        recording = recording.part(received(recording.stamps, 1, args.rate, gaps, rng)[0])
    return touched, recording


def _write_truth(args: argparse.Namespace, touched: SimulatedRecording,
                 recording: SimulatedRecording, sway: Sway | None, names: list[str],
                 places: Array) -> None:
    """Write the ground truth: in the frame of the reference array if there is one."""
    import numpy as np

    from gsdf_registration.common.rigid import inverse, transform
    from msg_adapters.truth import Truth, truth_path, write_truth

    means = np.array([touched.positions[touched.strokes == k].mean(axis=0)
                      for k in range(len(names))]).reshape(-1, 3)
    about = {option: getattr(args, option) for option in ABOUT}
    frame_id, T = args.frame_id, recording.T_tracker_bone
    if sway is not None:
        about['move'], frame_id = args.move, given.ARRAY_FRAME
        T_array_tracker = inverse(sway.T_tracker_body)
        T, means = T_array_tracker @ T, transform(T_array_tracker, means)
    about['outlier_share'] = round(1.0 - float(recording.on_bone.mean()), 4)
    write_truth(
        truth_path(args.output),
        Truth(given.relative(args.model, args.output), args.model_unit, frame_id, T, tuple(names),
              places.round(7), means.round(7), about))


def _write_bag(args: argparse.Namespace, touched: SimulatedRecording,
               recording: SimulatedRecording, sway: Sway | None) -> None:
    """Write the landmarks, then the points, and the poses of the reference array."""
    import numpy as np

    from gsdf_registration.common.rigid import inverse, transform
    from msg_adapters.bag import LANDMARK_TOPIC, TIP_TOPIC
    from msg_adapters.bag_writer import BagWriter

    with BagWriter(args.output, compressed=False) as bag:
        start = given.START
        for topic, part in ((LANDMARK_TOPIC, touched), (TIP_TOPIC, recording)):
            for since, position in zip(part.stamps, part.positions):
                stamp = round(start + float(since), 6)
                if sway is not None:
                    T_moved = sway.pose(stamp - given.START) @ inverse(sway.T_tracker_body)
                    position = transform(T_moved, position)
                position = (position / given.RESOLUTION).round() * given.RESOLUTION
                bag.write_point(topic, stamp, position, args.frame_id)
            start += 3.0 + float(part.stamps.max(initial=0.0))
        if sway is not None:
            for stamp in np.arange(given.START - 1.0, start, 1.0 / ARRAY_RATE):
                bag.write_pose(ARRAY_TOPIC, stamp, sway.pose(stamp - given.START), args.frame_id)
