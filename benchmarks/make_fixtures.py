# SPDX-License-Identifier: Apache-2.0
"""
Write bags/: bones from implicit solids and recordings made with `gsdf simulate`.

The files are reproduced bit for bit.

Usage: ``python benchmarks/make_fixtures.py [DIRECTORY]`` (default: bags/ of this checkout).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from gsdf_registration.simulation.bones import bone_landmarks, bone_mesh

BAGS = Path(__file__).resolve().parent.parent / 'bags'
# bag: bone and arguments of gsdf simulate, see also bags/README.md
RECORDINGS = {
    'hip_optical': ('hip', '--region acetabulum --points 600 --rate 80 --speed 40 --sigma 0.15 '
                    '--outliers 0.02 --interference lift_off:0.03 --dropouts 0.02 --seed 4'),
    'femur_em': ('femur', '--region proximal_femur --points 1000 --rate 40 --speed 20 --sigma 0.4 '
                 '--outliers 0.01 --interference lift_off:0.02 --seed 3'),
}


def make(directory: Path) -> None:
    """Write bones, recordings and ground truth to ``directory``, overwriting existing files."""
    directory.mkdir(parents=True, exist_ok=True)
    landmarks = {}
    for name in ('hip', 'femur'):
        mesh = bone_mesh(name)
        landmarks[name] = bone_landmarks(name, mesh)
        mesh.export(directory / f'{name}.ply', vertex_normal=False)
    for bag, (name, arguments) in RECORDINGS.items():
        shutil.rmtree(directory / bag, ignore_errors=True)
        options = [f'--landmark={mark}=' + ','.join(f'{value:.2f}' for value in place)
                   for mark, place in landmarks[name].items()]
        command = [sys.executable, '-m', 'gsdf_registration', 'simulate',
                   str(directory / f'{name}.ply'), *arguments.split(), *options,
                   '-o', str(directory / bag)]
        subprocess.run(command, check=True)


if __name__ == '__main__':
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else BAGS)
