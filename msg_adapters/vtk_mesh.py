# SPDX-License-Identifier: Apache-2.0
"""
Read surfaces from the files of VTK, .vtk and .vtp, with the library of the extra ct.

VTK ends the process that reads some damaged files. Therefore a process of its own reads them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsdf_registration.common.result import InputError
from msg_adapters.extras import require
from msg_adapters.mesh import Surface

VTK_FILES = ('.vtk', '.vtp')
PATIENCE = 300.0    # s; a mesh of a million triangles takes some seconds


class _Content(NamedTuple):
    surface: Surface
    axes: str | None


def load_vtk(path: Path) -> Surface:
    """
    Read the polygons of a file as triangles.

    Raises
    ------
    InputError
        If VTK is missing, or the file is damaged or has no polygons.

    """
    return _read(path).surface


def vtk_axes(path: Path) -> str | None:
    """Return the axes, lps or ras, that Slicer states in a file, None if there are none."""
    return _read(path).axes


def _read(path: Path) -> _Content:
    require('vtk', 'ct', '.vtk and .vtp files')
    root = str(Path(__file__).parents[1])
    paths = os.pathsep.join(filter(None, [root, os.environ.get('PYTHONPATH', '')]))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'surface.npz'
        try:
            done = subprocess.run(
                [sys.executable, '-m', 'msg_adapters.vtk_reader', str(path), str(out)],
                capture_output=True, text=True, timeout=PATIENCE, check=False,
                env={**os.environ, 'PYTHONPATH': paths})
        except subprocess.TimeoutExpired:
            raise InputError(f'{path} cannot be read: VTK takes more than {PATIENCE:.0f} s'
                             ) from None
        if done.returncode or not out.exists():
            reason = done.stdout.strip() if done.returncode == 2 else ''
            raise InputError(f'{path} cannot be read: {reason or "it is damaged"}')
        with np.load(out) as arrays:
            vertices, faces, axes = (arrays[name] for name in ('vertices', 'faces', 'axes'))
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        raise InputError(f'{path} is damaged: its faces refer to vertices that do not exist')
    return _Content(Surface(vertices, faces.astype(np.int32), None), str(axes) or None)
