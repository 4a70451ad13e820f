# SPDX-License-Identifier: Apache-2.0
"""``gsdf landmarks``: propose landmarks of a bone model."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import options, outputs
from gsdf_registration.common.command_line import example, progress_bar

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.registration.joint_centre import JointCentre

SCHEMA = 'gsdf-landmarks/1'


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'landmarks', help='propose landmarks of a bone model',
        description='Propose landmarks of a bone model, as settings for --params-file of the node '
        'and --config of gsdf: the centre of the hip joint, which ~/find_joint_centre finds on the '
        'patient, and the four most distant places of the bone, to be touched for an initial '
        'guess. The centre is that of the sphere through the femoral head or the acetabulum.',
        **example('gsdf landmarks femur.stl --json landmarks.json'))
    parser.add_argument('model', metavar='MODEL', help=options.MODEL_HELP)
    options.add_model_options(parser)
    parser.add_argument('--json', metavar='OUT',
                        help='write the landmarks as JSON; - for standard output instead of YAML')
    parser.add_argument('--markups', metavar='OUT.mrk.json|.fcsv',
                        help='write the landmarks as a point list of Slicer, in the axes that the '
                        'model states, else LPS')
    parser.set_defaults(run=run, model_unit='mm')


def run(args: argparse.Namespace) -> int:
    """Print the landmarks; a bone without a hip joint has only the distant places."""
    from gsdf_registration.common.result import InputError
    from gsdf_registration.field.model import load_model
    from gsdf_registration.registration.joint_centre import extreme_points, find_hip_centre
    from msg_adapters.slicer import check_point_list_path

    if args.markups:
        check_point_list_path(args.markups)
    field, centre = load_model(args.model, args.model_unit, label=args.label or '',
                               body=args.body or ''), None
    try:
        with progress_bar('searching for the hip joint') as show:
            centre = find_hip_centre(field, show)
    except InputError as error:
        print(f'note: {error.message}', file=sys.stderr)
    extremes = extreme_points(field)
    outputs.write_json(args.json, landmarks_to_json(field, centre, extremes))
    if args.markups:
        _write_markups(args.markups, args.model, _named(centre, extremes))
    if args.json != '-':
        print(landmarks_to_yaml(args.model, centre, extremes), end='')
    return 0


def _write_markups(path: str, model: str, landmarks: dict[str, Array]) -> None:
    import numpy as np

    from gsdf_registration.field.model import find_model
    from msg_adapters.slicer import PointList, model_axes, write_point_lists
    points = PointList('landmarks', list(landmarks), np.stack(list(landmarks.values())))
    write_point_lists(path, [points], model_axes(find_model(model)) or 'lps')


def landmarks_to_json(field: Field, centre: JointCentre | None, extremes: Array) -> dict[str, Any]:
    """Return the landmarks as a document, SI units; null if there is no hip joint."""
    return {
        'schema': SCHEMA,
        'model_sha256': field.bone_sha256,
        'hip_centre': None if centre is None else {
            'position_m': centre.centre.tolist(), 'radius_m': centre.radius, 'rms_m': centre.rms,
            'area_m2': centre.area, 'part': _part(centre)},
        'landmarks': {name: place.tolist() for name, place in _named(centre, extremes).items()},
    }


def landmarks_to_yaml(model: str, centre: JointCentre | None, extremes: Array) -> str:
    """Return the landmarks as settings; the comments say what they are."""
    about = ['there is no spherical part of a hip joint'] if centre is None else [
        f'hip_centre: the centre of the sphere through the {_part(centre)}, radius '
        f'{1e3 * centre.radius:.2f} mm,',
        f'  from which {1e4 * centre.area:.1f} cm^2 of the surface differ by '
        f'{1e3 * centre.rms:.2f} mm (RMS)']
    about += ['extreme_1 to extreme_4: the most distant places of the bone; rename those that you '
              'touch,', '  and remove the others']
    named = _named(centre, extremes)
    rows = ',\n                  '.join(
        ', '.join(f'{value:.6f}' for value in place) for place in named.values())
    return '\n'.join([
        f'# landmarks of {" ".join(model.split())}, proposed by gsdf landmarks',
        *(f'# {line}' for line in about),
        '/**:', '  ros__parameters:', '    landmarks:', f'      names: [{", ".join(named)}]',
        '      # x y z each, bone frame [m]', f'      positions: [{rows}]', ''])


def _named(centre: JointCentre | None, extremes: Array) -> dict[str, Array]:
    places = {f'extreme_{k}': place for k, place in enumerate(extremes, start=1)}
    return places if centre is None else {'hip_centre': centre.centre, **places}


def _part(centre: JointCentre) -> str:
    return 'acetabulum' if centre.hollow else 'femoral head'
