# SPDX-License-Identifier: Apache-2.0
"""``gsdf simulate``: record a simulated probe on a bone as a bag, with its ground truth."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gsdf_registration.cli import options
from gsdf_registration.common.command_line import example, number, whole_number
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.simulation.interference import Interference
    from gsdf_registration.simulation.moving import Sway
    from gsdf_registration.simulation.patch import Patch
    from gsdf_registration.simulation.probe import SimulatedRecording, Tracker

REGIONS = ('acetabulum', 'proximal_femur', 'condyles', 'proximal_tibia')
STRUCTURED = ('soft_tissue', 'lift_off', 'other_object', 'resting')
Number = TypeVar('Number', int, float)
START = 1_750_000_000.0     # s; a plausible clock time, the same for every recording
RESOLUTION = 1e-5           # m, of the positions that trackers report
# options that the ground truth records
ABOUT = ('region', 'points', 'rate', 'speed', 'sigma', 'distortion', 'outliers', 'interference',
         'dropouts', 'seed')
# the array that moves with the patient
ARRAY_TOPIC, ARRAY_FRAME, ARRAY_RATE = '/reference/pose', 'reference_array', 80.0   # Hz
EXAMPLES = (
    'gsdf simulate hip.ply --region acetabulum --points 600 --outliers 0.05 -o hip_bag',
    'gsdf simulate femur.ply --region=-25,0,20,38 --rate 40 --sigma 0.4 -o femur_bag',
    'gsdf simulate hip.ply --region acetabulum --move 20,10 -o moving_bag',
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
    add('--landmark', action='append', default=[], metavar='NAME=X,Y,Z',
        help='a model point that is touched first, with an error of 2 to 4 mm; may be repeated')
    add('--move', default='', metavar='MM/S,DEG/S',
        help='speed at which the patient moves and turns; adds a reference array with poses on '
        f'{ARRAY_TOPIC}, and the ground truth is in its frame (default: no motion, no array)')
    add('--frame-id', default='tracker', metavar='FRAME',
        help='frame of the points (default: %(default)s)')
    add('--seed', type=whole_number, default=0, metavar='N',
        help='of the random numbers (default: %(default)s)')
    parser.set_defaults(run=run, model_unit='mm')


def run(args: argparse.Namespace) -> int:
    """Simulate, write bag and ground truth, print a summary."""
    from gsdf_registration.common.rigid import transform
    from msg_adapters.truth import truth_path

    patch = _patch(args)
    names, places = _landmarks(args)
    touched, recording = _simulate(args, patch, places)
    sway = _sway(args, transform(recording.T_tracker_bone, patch.centre))
    _write_bag(args, touched, recording, sway)
    _write_truth(args, touched, recording, sway, names, places)
    print(f'{args.output}: {len(recording.stamps)} points in {recording.stamps[-1]:.1f} s, '
          f'{int(recording.on_bone.sum())} of them on the bone, '
          f'{format_count(len(names), "landmark")}; ground truth in {truth_path(args.output)}')
    return 0


def _simulate(args: argparse.Namespace, patch: Patch,
              places: Array) -> tuple[SimulatedRecording, SimulatedRecording]:
    """Return the recordings of the landmarks (k, 3), m, bone frame, and of the exposed area."""
    import numpy as np

    from gsdf_registration.simulation.probe import (
        Hand,
        random_pose,
        simulate_landmarks,
        simulate_scan,
    )

    rng = np.random.default_rng(_at_least(0, args.seed, '--seed'))
    T = random_pose(rng, translation=0.3)
    # in the middle of the tracker's volume
    T[:3, 3] += np.array([0.0, 0.0, -1.3]) - T[:3, :3] @ patch.centre
    settings: dict[str, Any] = {'tracker': _tracker(args), 'T_tracker_bone': T}
    hand = Hand(speed=_at_least(1.0, args.speed, '--speed') * 1e-3)
    touched = simulate_landmarks(places, rng, **settings)
    recording = simulate_scan(patch, _at_least(30, args.points, '--points'), rng,
                              interference=_interference(args), hand=hand, **settings)
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
        about['move'], frame_id = args.move, ARRAY_FRAME
        T_array_tracker = inverse(sway.T_tracker_body)
        T, means = T_array_tracker @ T, transform(T_array_tracker, means)
    about['outlier_share'] = round(1.0 - float(recording.on_bone.mean()), 4)
    write_truth(
        truth_path(args.output),
        Truth(_relative(args.model, args.output), args.model_unit, frame_id, T, tuple(names),
              places.round(7), means.round(7), about))


def _write_bag(args: argparse.Namespace, touched: SimulatedRecording,
               recording: SimulatedRecording, sway: Sway | None) -> None:
    """Write the landmarks, then the points, and the poses of the reference array."""
    import numpy as np

    from gsdf_registration.common.rigid import inverse, transform
    from msg_adapters.bag import LANDMARK_TOPIC, TIP_TOPIC
    from msg_adapters.bag_writer import BagWriter

    with BagWriter(args.output) as bag:
        start = START
        for topic, part in ((LANDMARK_TOPIC, touched), (TIP_TOPIC, recording)):
            for since, position in zip(part.stamps, part.positions):
                stamp = round(start + float(since), 6)
                if sway is not None:
                    T_moved = sway.pose(stamp - START) @ inverse(sway.T_tracker_body)
                    position = transform(T_moved, position)
                bag.write_point(topic, stamp, (position / RESOLUTION).round() * RESOLUTION,
                                args.frame_id)
            start += 3.0 + float(part.stamps.max(initial=0.0))
        if sway is not None:
            for stamp in np.arange(START - 1.0, start, 1.0 / ARRAY_RATE):
                bag.write_pose(ARRAY_TOPIC, stamp, sway.pose(stamp - START), args.frame_id)


def _sway(args: argparse.Namespace, incision: Array) -> Sway | None:
    """Return the motion of an array 0.1 m from the incision (3,), m; None without an array."""
    import numpy as np

    from gsdf_registration.common.rigid import from_rt
    from gsdf_registration.simulation.moving import Sway

    if not args.move:
        return None
    speed, turn = _numbers(args.move, 2, '--move')
    if min(speed, turn) < 0.0:
        raise InputError(f'--move must not be negative: "{args.move}"')
    return Sway(from_rt(np.eye(3), incision + [0.1, 0.0, 0.0]), speed * 1e-3, np.radians(turn))


def _relative(model: str, output: str) -> str:
    """Return the path of the model relative to the directory of the ground truth."""
    return os.path.relpath(Path(model).resolve(), Path(output).resolve().parent)


def _patch(args: argparse.Namespace) -> Patch:
    """Return the exposed area."""
    from gsdf_registration.mesh.bone import make_bone
    from gsdf_registration.simulation.patch import exposed_patch
    from gsdf_registration.simulation.regions import named_patch
    from msg_adapters.files import unit_scale
    from msg_adapters.points import read_model

    bone = make_bone(*read_model(args.model, args.model_unit, args.label or ''), args.body or '')
    if bone.faces is None:
        raise InputError(f'{args.model} is a point cloud; give a mesh')
    if ',' not in args.region:
        return named_patch(args.region, bone.vertices, bone.faces)
    x, y, z, radius = _numbers(args.region, 4, '--region') * unit_scale(args.model_unit)
    return exposed_patch(bone.vertices, bone.faces, (x, y, z), radius)


def _tracker(args: argparse.Namespace) -> Tracker:
    from gsdf_registration.simulation.probe import Tracker

    sigma = (_numbers(args.sigma, 3 if ',' in args.sigma else 1, '--sigma') * 1e-3).tolist()
    x, y, z = sigma if len(sigma) == 3 else 3 * sigma
    if min(x, y, z) < 0.0 or not 0.0 <= args.dropouts < 0.9:
        raise InputError('--sigma must not be negative and --dropouts must lie in [0, 0.9)')
    return Tracker(rate=_at_least(1.0, args.rate, '--rate'),
                   sigma=(x, y, z),
                   dropouts=args.dropouts,
                   distortion=_at_least(0.0, args.distortion, '--distortion') * 1e-3)


def _interference(args: argparse.Namespace) -> Interference:
    from gsdf_registration.simulation.interference import Interference

    shares = {'uniform': args.outliers}
    for word in filter(None, args.interference.split(',')):
        kind, _, share = word.partition(':')
        if kind not in STRUCTURED:
            raise InputError(
                f'--interference: "{kind}" is unknown; choose one of {", ".join(STRUCTURED)}')
        shares[kind] = float(_numbers(share, 1, f'--interference {kind}')[0])
    return Interference(**shares)


def _landmarks(args: argparse.Namespace) -> tuple[list[str], Array]:
    """Return names and positions (k, 3), m, bone frame."""
    import numpy as np

    from msg_adapters.files import unit_scale

    pairs = [word.partition('=') for word in args.landmark]
    places = [_numbers(place, 3, f'--landmark {name}') for name, _, place in pairs]
    return [name for name, _, _ in pairs], np.reshape(places, (-1, 3)) * unit_scale(args.model_unit)


def _numbers(text: str, count: int, option: str) -> Array:
    """Return ``count`` numbers separated by commas, or raise `InputError`."""
    import numpy as np

    try:
        numbers = np.array([float(word) for word in text.split(',')])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(
            f'{option} must be {format_count(count, "number")} separated by commas, not "{text}"')
    return numbers


def _at_least(low: float, value: Number, option: str) -> Number:
    if not low <= value < float('inf'):
        raise InputError(f'{option} must be at least {low:g}, not {value:g}')
    return value
