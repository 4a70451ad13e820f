# SPDX-License-Identifier: Apache-2.0
"""What the options of ``gsdf simulate`` mean: the bone, the tracker, the hand, the patient."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    import numpy as np

    from gsdf_registration.common.rigid import Array
    from gsdf_registration.simulation.interference import Interference
    from gsdf_registration.simulation.losses import Losses
    from gsdf_registration.simulation.moving import Sway
    from gsdf_registration.simulation.probe import Hand, Tracker
    from gsdf_registration.simulation.touched_bone import TouchedBone

START = 1_750_000_000.0     # s; a plausible clock time, the same for every recording
RESOLUTION = 1e-5           # m, of the positions that trackers report
ARRAY_FRAME = 'reference_array'     # of the array that moves with the patient
STRUCTURED = ('soft_tissue', 'lift_off', 'other_object', 'resting')
Number = TypeVar('Number', int, float)


def touched_bone(args: argparse.Namespace) -> TouchedBone:
    """Return the bone, the exposed area, and what covers it."""
    import numpy as np

    from gsdf_registration.mesh.bone import make_bone
    from gsdf_registration.simulation.patch import exposed_patch
    from gsdf_registration.simulation.regions import named_patch
    from gsdf_registration.simulation.touched_bone import TouchedBone
    from msg_adapters.files import unit_scale
    from msg_adapters.points import read_model

    bone = make_bone(*read_model(args.model, args.model_unit, args.label or ''), args.body or '')
    if bone.faces is None:
        raise InputError(f'{args.model} is a point cloud; give a mesh')
    if ',' not in args.region:
        patch = named_patch(args.region, bone.vertices, bone.faces)
    else:
        x, y, z, radius = numbers(args.region, 4, '--region') * unit_scale(args.model_unit)
        patch = exposed_patch(bone.vertices, bone.faces, (x, y, z), radius)
    return TouchedBone(bone.vertices, np.asarray(bone.faces), patch, 1e-3 * args.tip_radius,
                       args.cartilage, 1e-3 * args.soft_tissue)


def bone_pose(bone: TouchedBone, rng: np.random.Generator) -> Array:
    """Return a random pose of the bone, ``T_tracker_bone`` (4, 4), m."""
    import numpy as np

    from gsdf_registration.simulation.probe import random_pose

    T = random_pose(rng, translation=0.3)
    # in the middle of the tracker's volume
    T[:3, 3] += np.array([0.0, 0.0, -1.3]) - T[:3, :3] @ bone.patch.centre
    return T


def hand(args: argparse.Namespace) -> Hand:
    """Return how the hand moves the probe."""
    from gsdf_registration.simulation.probe import Hand

    shortest, longest = numbers(args.pause, 2, '--pause')
    if not 0.0 < shortest <= longest:
        raise InputError(f'--pause must be two rising times above 0, not "{args.pause}"')
    return Hand(speed=at_least(1.0, args.speed, '--speed') * 1e-3,
                unsteadiness=at_least(0.0, args.unsteadiness, '--unsteadiness'),
                stroke=at_least(1.0, args.stroke, '--stroke') * 1e-3,
                pause=(float(shortest), float(longest)))


def losses(args: argparse.Namespace) -> Losses:
    """Return what the tracker does not report."""
    from gsdf_registration.simulation.losses import Losses

    return Losses(args.dropouts, at_least(0.0, args.gaps, '--gaps'))


def sway(args: argparse.Namespace, incision: Array) -> Sway | None:
    """Return the motion of an array 0.1 m from the incision (3,), m; None without an array."""
    import numpy as np

    from gsdf_registration.common.rigid import from_rt
    from gsdf_registration.simulation.moving import Sway

    if not args.move:
        return None
    speed, turn = numbers(args.move, 2, '--move')
    if min(speed, turn) < 0.0:
        raise InputError(f'--move must not be negative: "{args.move}"')
    return Sway(from_rt(np.eye(3), incision + [0.1, 0.0, 0.0]), speed * 1e-3, np.radians(turn))


def relative(model: str, output: str) -> str:
    """Return the path of the model relative to the directory of the ground truth."""
    return os.path.relpath(Path(model).resolve(), Path(output).resolve().parent)


def tracker(args: argparse.Namespace, rng: np.random.Generator) -> Tracker:
    """Return the tracker; its distortion is random and the same for all parts of a recording."""
    from gsdf_registration.simulation.distortion import Distortion
    from gsdf_registration.simulation.probe import Tracker

    sigma = (numbers(args.sigma, 3 if ',' in args.sigma else 1, '--sigma') * 1e-3).tolist()
    x, y, z = sigma if len(sigma) == 3 else 3 * sigma
    if min(x, y, z) < 0.0 or not 0.0 <= args.dropouts < 0.9:
        raise InputError('--sigma must not be negative and --dropouts must lie in [0, 0.9)')
    rms = at_least(0.0, args.distortion, '--distortion') * 1e-3
    return Tracker(rate=at_least(1.0, args.rate, '--rate'), sigma=(x, y, z), dropouts=args.dropouts,
                   distortion=Distortion.random(rms, rng) if rms else 0.0)


def interference(args: argparse.Namespace) -> Interference:
    """Return the shares of samples that are not on the bone in a stroke."""
    from gsdf_registration.simulation.interference import Interference

    shares = {'uniform': args.outliers}
    for word in filter(None, args.interference.split(',')):
        kind, _, share = word.partition(':')
        if kind not in STRUCTURED:
            raise InputError(
                f'--interference: "{kind}" is unknown; choose one of {", ".join(STRUCTURED)}')
        shares[kind] = float(numbers(share, 1, f'--interference {kind}')[0])
    return Interference(**shares)


def landmarks(args: argparse.Namespace) -> tuple[list[str], Array]:
    """Return names and positions (k, 3), m, bone frame."""
    import numpy as np

    from msg_adapters.files import unit_scale

    pairs = [word.partition('=') for word in args.landmark]
    places = [numbers(place, 3, f'--landmark {name}') for name, _, place in pairs]
    return [name for name, _, _ in pairs], np.reshape(places, (-1, 3)) * unit_scale(args.model_unit)


def numbers(text: str, count: int, option: str) -> Array:
    """Return ``count`` numbers separated by commas, or raise `InputError`."""
    import numpy as np

    try:
        values = np.array([float(word) for word in text.split(',')])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(
            f'{option} must be {format_count(count, "number")} separated by commas, not "{text}"')
    return values


def at_least(low: float, value: Number, option: str) -> Number:
    """Return ``value``, or raise `InputError` if it is below ``low`` or not finite."""
    if not low <= value < float('inf'):
        raise InputError(f'{option} must be at least {low:g}, not {value:g}')
    return value
