# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks fixtures``: write the bones and recordings of bags/, bit for bit."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from gsdf_registration.common.command_line import example
from gsdf_registration.common.result import InputError

BAGS = Path(__file__).resolve().parents[2] / 'bags'
ALL, PROXIMAL, DISTAL = slice(None), slice(0, 3), slice(3, None)
# bag: bone, its landmarks, and arguments of gsdf simulate, see also bags/README.md
RECORDINGS = {
    'hip_optical': ('hip', ALL, '--region acetabulum --points 600 --rate 80 --speed 40 '
                    '--sigma 0.15 --outliers 0.02 --interference lift_off:0.03 --dropouts 0.02 '
                    '--seed 4'),
    'femur_em': ('femur', PROXIMAL, '--region proximal_femur --points 1000 --rate 40 --speed 20 '
                 '--sigma 0.4 --outliers 0.01 --interference lift_off:0.02 --seed 3'),
    'femur_tool': ('femur', DISTAL, '--region condyles --tool-poses --points 600 --rate 40 '
                   '--speed 28 --unsteadiness 0.6 --stroke 80 --pause 1.3,2.6 --sigma 0.15 '
                   '--outliers 0.005 --dropouts 0.03 --gaps 3 --tip-radius 1 --pivoting 12 '
                   '--swinging 15 --move 20,5 --seed 5'),
}


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'fixtures', help='write the bones and recordings of bags/',
        description='Write the simulated bones, recordings and ground truth of bags/. The files '
        'are the same on every machine, bit for bit. Needs scikit-image.',
        **example('python -m benchmarks fixtures'))
    parser.add_argument('directory', nargs='?', type=Path, default=BAGS, metavar='DIRECTORY',
                        help='existing files are overwritten (default: bags/ of this checkout)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write bones, recordings and ground truth."""
    from importlib.util import find_spec

    from gsdf_registration.simulation.bones import bone_landmarks, bone_mesh
    if find_spec('skimage') is None:
        raise InputError('the bones need scikit-image, which is not installed: '
                         'pip install scikit-image')
    directory = args.directory
    directory.mkdir(parents=True, exist_ok=True)
    landmarks = {}
    for name in ('hip', 'femur'):
        mesh = bone_mesh(name)
        landmarks[name] = bone_landmarks(name, mesh)
        mesh.export(directory / f'{name}.ply', vertex_normal=False)
    for bag, (name, touched, arguments) in RECORDINGS.items():
        shutil.rmtree(directory / bag, ignore_errors=True)
        options = [f'--landmark={mark}=' + ','.join(f'{value:.2f}' for value in place)
                   for mark, place in list(landmarks[name].items())[touched]]
        command = [sys.executable, '-m', 'gsdf_registration', 'simulate',
                   str(directory / f'{name}.ply'), *arguments.split(), *options,
                   '-o', str(directory / bag)]
        subprocess.run(command, check=True)
    return 0
