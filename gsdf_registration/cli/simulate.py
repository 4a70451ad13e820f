# SPDX-License-Identifier: Apache-2.0
"""`gsdf simulate`: a probe dragged over a bone, recorded as a bag with its truth beside it."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.simulation.interference import Interference
    from gsdf_registration.simulation.moving import Sway
    from gsdf_registration.simulation.patch import Patch
    from gsdf_registration.simulation.probe import Drag, Tracker

REGIONS = ('acetabulum', 'proximal_femur', 'condyles', 'proximal_tibia')
STRUCTURED = ('soft_tissue', 'lift_off', 'other_object', 'resting')
Number = TypeVar('Number', int, float)
START = 1_750_000_000.0     # s; stamps like those of a clock, the same in every run
RESOLUTION = 1e-5           # m; trackers report hundredths of a millimetre
# what the truth says of how it was made
ABOUT = ('region', 'points', 'rate', 'speed', 'sigma', 'distortion', 'outliers', 'interference',
         'dropouts', 'seed')
# the array that moves with the patient
ARRAY_TOPIC, ARRAY_FRAME, ARRAY_RATE = '/reference/pose', 'reference_array', 80.0   # Hz
EXAMPLE = """\
examples:
  gsdf simulate hip.ply --region acetabulum --points 600 --outliers 0.05 -o hip_run
  gsdf simulate femur.ply --region=-25,0,20,38 --rate 40 --sigma 0.4 -o femur_run
  gsdf simulate hip.ply --region acetabulum --move 20,10 -o moving_run
"""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser = subparsers.add_parser(
        'simulate',
        help='record a simulated probe run over a bone, with its ground truth',
        description=
        'Drag a probe over a bone and record it as a rosbag2 (mcap), with the ground truth in a '
        'YAML of the same name. The same arguments give the same bytes.',
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('model', help='mesh of the bone (STL, PLY, OBJ, OFF)')
    parser.add_argument(
        '--region',
        required=True,
        metavar='NAME|X,Y,Z,RADIUS',
        help=f'what the wound exposes: {", ".join(REGIONS)}, or a ball in units of the model')
    parser.add_argument('-o',
                        '--output',
                        required=True,
                        metavar='BAG',
                        help='directory of the new bag')
    parser.add_argument('--model-unit',
                        choices=('mm', 'm'),
                        default='mm',
                        help='(default: %(default)s)')
    parser.add_argument(
        '--points',
        type=int,
        default=600,
        metavar='N',
        help='samples on the bone; interference comes on top (default: %(default)s)')
    parser.add_argument('--rate',
                        type=float,
                        default=80.0,
                        metavar='HZ',
                        help='(default: %(default)s)')
    parser.add_argument('--speed', type=float, default=27.0, metavar='MM/S',
                        help='median speed of the tip (default: %(default)s)')
    parser.add_argument('--sigma', default='0.15', metavar='MM|X,Y,Z',
                        help='noise per axis of the tracker (default: %(default)s)')
    parser.add_argument(
        '--distortion',
        type=float,
        default=0.0,
        metavar='MM',
        help='smooth distortion, as of an electromagnetic field, RMS (default: none)')
    parser.add_argument(
        '--outliers',
        type=float,
        default=0.0,
        metavar='SHARE',
        help="share of all samples that lie anywhere in the model's box (default: none)")
    parser.add_argument('--interference', default='', metavar='KIND:SHARE,...',
                        help='soft_tissue, lift_off, other_object, resting, each with its share')
    parser.add_argument(
        '--dropouts',
        type=float,
        default=0.0,
        metavar='SHARE',
        help='share of the samples on the bone that the tracker misses (default: none)')
    parser.add_argument(
        '--landmark',
        action='append',
        default=[],
        metavar='NAME=X,Y,Z',
        help='a model point to be touched first, missed by 2 to 4 mm; may be repeated')
    parser.add_argument(
        '--move', default='', metavar='MM/S,DEG/S',
        help='the patient moves and turns so fast, with a reference array whose poses are on '
        f'{ARRAY_TOPIC} and in whose frame the truth is told (default: still, without array)')
    parser.add_argument('--frame-id', default='tracker', help='(default: %(default)s)')
    parser.add_argument('--seed', type=int, default=0, help='(default: %(default)s)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, write bag and truth, say so in one line; `InputError` for what cannot be."""
    import numpy as np

    from gsdf_registration.common.rigid import inverse, transform
    from gsdf_registration.simulation.probe import Hand, drag, random_pose, rest
    from msg_adapters.truth import Truth, truth_path, write_truth

    patch = _patch(args)
    rng = np.random.default_rng(_at_least(0, args.seed, '--seed'))
    tracker = _tracker(args)
    names, places = _landmarks(args)
    T = random_pose(rng, translation=0.3)
    T[:3, 3] += np.array([0.0, 0.0, -1.3]) - T[:3, :3] @ patch.centre   # where cameras see well
    settings: dict[str, Any] = {'tracker': tracker, 'T_tracker_bone': T}
    touched = rest(places, rng, **settings)
    run_ = drag(patch,
                _at_least(30, args.points, '--points'),
                rng,
                interference=_interference(args),
                hand=Hand(speed=_at_least(1.0, args.speed, '--speed') * 1e-3),
                **settings)
    means = np.array([touched.positions[touched.strokes == k].mean(axis=0)
                      for k in range(len(names))]).reshape(-1, 3)
    about = {option: getattr(args, option) for option in ABOUT}
    frame_id, sway = args.frame_id, _sway(args, transform(T, patch.centre))
    _write_bag(args, touched, run_, sway)
    if sway is not None:
        about['move'], frame_id = args.move, ARRAY_FRAME
        T_array_tracker = inverse(sway.T_tracker_body)
        T, means = T_array_tracker @ T, transform(T_array_tracker, means)
    about['outlier_share'] = round(1.0 - float(run_.on_bone.mean()), 4)
    write_truth(
        truth_path(args.output),
        Truth(_relative(args.model, args.output), args.model_unit, frame_id, T, tuple(names),
              places.round(7), means.round(7), about))
    print(
        f'{args.output}: {len(run_.stamps)} points in {run_.stamps[-1]:.1f} s, '
        f'{int(run_.on_bone.sum())} of them on the bone, {counted(len(names), "landmark")}; '
        f'truth in {truth_path(args.output)}')
    return 0


def _write_bag(args: argparse.Namespace, touched: Drag, run_: Drag, sway: Sway | None) -> None:
    """Write the landmarks, then the run, and where the reference array was meanwhile."""
    import numpy as np

    from gsdf_registration.common.rigid import inverse, transform
    from msg_adapters.bag import LANDMARK_TOPIC, TIP_TOPIC
    from msg_adapters.bag_writer import BagWriter

    with BagWriter(args.output) as bag:
        start = START
        for topic, part in ((LANDMARK_TOPIC, touched), (TIP_TOPIC, run_)):
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


def _sway(args: argparse.Namespace, wound: Array) -> Sway | None:
    """Return how an array 0.1 m beside the wound (3,), m, moves; None if there is none."""
    import numpy as np

    from gsdf_registration.common.rigid import from_rt
    from gsdf_registration.simulation.moving import Sway

    if not args.move:
        return None
    speed, turn = _numbers(args.move, 2, '--move')
    if min(speed, turn) < 0.0:
        raise InputError(f'--move must not be negative, not "{args.move}"')
    return Sway(from_rt(np.eye(3), wound + [0.1, 0.0, 0.0]), speed * 1e-3, np.radians(turn))


def _relative(model: str, output: str) -> str:
    """Return the model's path as seen from the truth's directory."""
    return os.path.relpath(Path(model).resolve(), Path(output).resolve().parent)


def _patch(args: argparse.Namespace) -> Patch:
    """Return what the wound exposes."""
    from gsdf_registration.mesh.bone import make_bone
    from gsdf_registration.simulation.patch import exposed_patch
    from gsdf_registration.simulation.regions import named_patch
    from msg_adapters.files import metres_per
    from msg_adapters.points import read_model

    bone = make_bone(*read_model(args.model, args.model_unit))
    if bone.faces is None:
        raise InputError(f'{args.model} is a point cloud; a probe is dragged over a mesh')
    if ',' not in args.region:
        return named_patch(args.region, bone.vertices, bone.faces)
    x, y, z, radius = _numbers(args.region, 4, '--region') * metres_per(args.model_unit)
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
                f'--interference: "{kind}" is not known; say one of {", ".join(STRUCTURED)}')
        shares[kind] = float(_numbers(share, 1, f'--interference {kind}')[0])
    return Interference(**shares)


def _landmarks(args: argparse.Namespace) -> tuple[list[str], Array]:
    """Return names and positions (k, 3), m, bone frame."""
    import numpy as np

    from msg_adapters.files import metres_per

    pairs = [word.partition('=') for word in args.landmark]
    places = [_numbers(place, 3, f'--landmark {name}') for name, _, place in pairs]
    return [name for name, _, _ in pairs], np.reshape(places, (-1, 3)) * metres_per(args.model_unit)


def _numbers(text: str, count: int, option: str) -> Array:
    """Return ``count`` numbers between commas, or raise InputError."""
    import numpy as np

    try:
        numbers = np.array([float(word) for word in text.split(',')])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(
            f'{option} must be {counted(count, "number")} between commas, not "{text}"')
    return numbers


def _at_least(low: float, value: Number, option: str) -> Number:
    if not low <= value < float('inf'):
        raise InputError(f'{option} must be at least {low:g}, not {value:g}')
    return value
