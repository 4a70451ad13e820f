# SPDX-License-Identifier: Apache-2.0
"""``gsdf simulate --tool-poses``: record poses of a probe and of a reference array."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import simulation_options as given
from gsdf_registration.common.command_line import number
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    import numpy as np

    from gsdf_registration.common.rigid import Array
    from gsdf_registration.simulation.operation import Operation, Plan
    from gsdf_registration.simulation.touched_bone import TouchedBone

# each part has a topic of its own, so that it can be played alone
TOPICS = {'strokes': '/probe/measured_cp', 'landmarks': '/probe/landmarks',
          'pivoting': '/probe/pivoting', 'still': '/array/measured_cp',
          'swinging': '/array/swinging'}
NO_MOTION = '0,0'
DIGITS = 6      # of quaternions, as trackers report them
ABOUT = ('region', 'points', 'rate', 'speed', 'unsteadiness', 'sigma', 'distortion', 'outliers',
         'interference', 'dropouts', 'gaps', 'tip_radius', 'cartilage', 'soft_tissue', 'pivoting',
         'swinging', 'orientation_noise', 'move', 'seed')


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for poses of a tool."""
    add = parser.add_argument
    add('--tool-poses', action='store_true',
        help='record poses of the probe and of a reference array instead of positions of the tip, '
        f'on {", ".join(TOPICS.values())}; the ground truth is in the frame of the array')
    add('--pivoting', type=number, default=0.0, metavar='S',
        help='turn the probe in a divot first, for S seconds (default: not)')
    add('--swinging', type=number, default=0.0, metavar='S',
        help='swing the leg about the hip, for S seconds; the model must have a femoral head '
        '(default: not)')
    add('--orientation-noise', type=number, default=0.1, metavar='DEG',
        help='noise per axis of the orientations (default: %(default)s)')
    add('--tip', default='', metavar='X,Y,Z',
        help='position of the tip in the frame of the tool, mm (default: 12,-21,148)')


def refuse_options(args: argparse.Namespace) -> None:
    """Raise `InputError` if an option needs ``--tool-poses``."""
    for option in ('pivoting', 'swinging', 'tip'):
        if getattr(args, option):
            raise InputError(f'--{option} needs --tool-poses')


def run(args: argparse.Namespace, bone: TouchedBone, names: list[str], places: Array) -> int:
    """Simulate, write bag and ground truth, print a summary."""
    import numpy as np

    from gsdf_registration.common.rigid import transform
    from gsdf_registration.simulation.operation import simulate_operation
    from gsdf_registration.simulation.regions import femoral_head
    from msg_adapters.truth import truth_path

    rng = np.random.default_rng(given.at_least(0, args.seed, '--seed'))
    plan, hip_centre = _plan(args, rng), None
    if plan.swinging:
        hip_centre = femoral_head(bone.vertices, bone.faces)
    T = given.bone_pose(bone, rng)
    args.move = args.move or NO_MOTION
    sway = given.sway(args, transform(T, bone.patch.centre))
    assert sway is not None
    operation = simulate_operation(bone, plan, sway, T, places, rng, hip_centre)
    _write_bag(args, operation)
    _write_truth(args, operation, plan, names, places, hip_centre)
    probe = sum(len(poses.stamps) for poses in operation.probe.values())
    array = sum(len(poses.stamps) for poses in operation.array.values())
    print(f'{args.output}: {probe} poses of the probe and {array} of the reference array, '
          f'{int(operation.strokes.on_bone.sum())} samples on the bone, '
          f'{format_count(len(names), "landmark")}; ground truth in {truth_path(args.output)}')
    return 0


def _plan(args: argparse.Namespace, rng: np.random.Generator) -> Plan:
    """Return what is done and how it is recorded."""
    from dataclasses import replace

    import numpy as np

    from gsdf_registration.simulation.operation import Plan
    from gsdf_registration.simulation.tool_motion import Tool

    tool = Tool()
    if args.tip:
        x, y, z = (1e-3 * given.numbers(args.tip, 3, '--tip')).tolist()
        tool = Tool((x, y, z))
    return Plan(given.at_least(30, args.points, '--points'),
                given.at_least(0.0, args.pivoting, '--pivoting'),
                given.at_least(0.0, args.swinging, '--swinging'),
                replace(given.tracker(args, rng), dropouts=0.0),
                np.radians(given.at_least(0.0, args.orientation_noise, '--orientation-noise')),
                given.losses(args), given.hand(args), given.interference(args), tool)


def _write_bag(args: argparse.Namespace, operation: Operation) -> None:
    """Write all poses in the order of their stamps."""
    from msg_adapters.bag_writer import BagWriter

    parts = {**operation.array, **operation.probe}
    rows = sorted((float(stamp), order, row) for order, poses in enumerate(parts.values())
                  for row, stamp in enumerate(poses.stamps))
    names = list(parts)
    with BagWriter(args.output, compressed=False) as bag:
        for stamp, order, row in rows:
            T = parts[names[order]].T_tracker_body[row].copy()
            T[:3, 3] = (T[:3, 3] / given.RESOLUTION).round() * given.RESOLUTION
            bag.write_pose(TOPICS[names[order]], round(given.START + stamp, 6), T, args.frame_id,
                           digits=DIGITS)


def _write_truth(args: argparse.Namespace, operation: Operation, plan: Plan, names: list[str],
                 places: Array, hip_centre: Array | None) -> None:
    """Write the ground truth, with the calls of the operator and what was found by turning."""
    from gsdf_registration.common.rigid import transform
    from msg_adapters.truth import Truth, truth_path, write_truth

    about: dict[str, Any] = {option: getattr(args, option) for option in ABOUT}
    about['tip'] = list(plan.tool.tip)
    about['shaft'] = list(plan.tool.shaft)
    if plan.pivoting:
        about['pivot'] = operation.pivot.tolist()
    if hip_centre is not None:
        about['hip_centre'] = {
            'model': hip_centre.round(7).tolist(),
            'array': transform(operation.T_array_bone, hip_centre).round(7).tolist()}
    about['outlier_share'] = round(1.0 - float(operation.strokes.on_bone.mean()), 4)
    about['calls'] = [[round(given.START + call.stamp, 6), call.service]
                      + ([] if call.data is None else [call.data]) for call in operation.calls]
    write_truth(
        truth_path(args.output),
        Truth(given.relative(args.model, args.output), args.model_unit, given.ARRAY_FRAME,
              operation.T_array_bone, tuple(names), places.round(7),
              operation.landmarks.round(7), about))
