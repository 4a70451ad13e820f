# SPDX-License-Identifier: Apache-2.0
"""
Bone models, touched points and landmarks from files.

Their unit is said by the caller, never guessed.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters import ndi
from msg_adapters.files import metres_per, readable_file
from msg_adapters.mesh import load_surface
from msg_adapters.recording import Recording
from msg_adapters.table import Table, read_table

MESHES = ('.stl', '.ply', '.obj', '.off')
TEXTS = ('.csv', '.txt', '.xyz')
XYZ = ('x', 'y', 'z')
NORMAL = ('nx', 'ny', 'nz')


class Landmarks(NamedTuple):
    """Names, positions in the bone frame (k, 3) m, and where touched, tracker frame (k, 3) m."""

    names: list[str]
    model: Array
    tracker: Array


def read_model(path: str | os.PathLike[str],
               unit: str) -> tuple[Array, NDArray[np.int32] | None, Array | None]:
    """
    Read a bone's surface as it stands in its file: a mesh, or points with normals.

    STL, PLY, OBJ and OFF are read as meshes (several bodies become one); a PLY without faces, XYZ
    and CSV as points with normals, ``nx, ny, nz`` or the last three of six columns.

    Parameters
    ----------
    path : path
        Of the file.
    unit : {'mm', 'm'}
        Of its lengths.

    Returns
    -------
    vertices : (n, 3) float64, m, bone frame
    faces : (m, 3) int32, or None for points
    normals : (n, 3) float64, or None for a mesh

    Raises
    ------
    InputError
        If the file is missing, damaged, cut short, of unknown kind, or has no faces and no normals.

    """
    scale = metres_per(unit)
    path = readable_file(path)
    kind = path.suffix.lower()
    if kind in MESHES:
        vertices, faces, normals = load_surface(path)
    elif kind in TEXTS:
        table = _points_table(path)
        named = bool(table.columns)
        has_normals = set(NORMAL) <= set(table.columns) if named else len(table.rows[0]) == 6
        vertices, faces = table.numbers(*(XYZ if named else range(3))), None
        normals = table.numbers(*(NORMAL if named else range(3, 6))) if has_normals else None
    else:
        raise InputError(
            f'{path}: a model is an STL, PLY, OBJ or OFF file, or points with normals as PLY, '
            'XYZ or CSV')
    if faces is None and normals is None:
        raise InputError(
            f'{path} has neither faces nor normals: give a mesh, or points with nx, ny, nz')
    if not np.isfinite(vertices).all() or (normals is not None and not np.isfinite(normals).all()):
        raise InputError(f'{path} has coordinates that are not finite: export the model again')
    return vertices * scale, faces, normals


def read_points(path: str | os.PathLike[str], unit: str) -> Recording:
    """
    Read touched points.

    CSV, TXT and XYZ with a header that names x, y, z in any order (and, if there, t/time/stamp in
    seconds, quality/error in ``unit``, stroke, frame_id) or with x y z and no header; PLY; or an
    NDI tracker CSV, known by its header.

    Parameters
    ----------
    path : path
        Of the file.
    unit : {'mm', 'm'}
        Of its lengths.

    Returns
    -------
    Recording
        In metres; rows whose coordinates are empty or not finite are kept for the gates to count.

    Raises
    ------
    InputError
        If the file cannot be read as one of these, or holds no points; the sentence names the line.

    """
    scale = metres_per(unit)
    path = readable_file(path)
    kind = path.suffix.lower()
    if kind == '.ply':
        surface = load_surface(path)
        if surface.faces is not None:
            raise InputError(f'{path} has faces: it is a surface and not a list of touched points')
        return Recording(surface.vertices * scale, source_names=[path.name])
    if kind not in TEXTS:
        raise InputError(
            f'{path}: points are a CSV, TXT or XYZ file with x, y, z, a PLY, or an NDI tracker '
            'CSV')
    if ndi.is_ndi(path):
        if unit != 'mm':
            raise InputError(f'{path} is an NDI tracker file, which is in mm: say unit mm')
        return ndi.read_ndi(path)
    return _recording(_points_table(path), path.name, scale)


def _points_table(path: Path) -> Table:
    """Read a table that has x, y, z by name, or three or six columns and no header."""
    table = read_table(path, wanted=XYZ)
    if table.columns and not set(XYZ) <= set(table.columns):
        raise InputError(f'{path}: the columns {", ".join(table.columns)} do not include x, y, z')
    if not table.rows:
        raise InputError(f'{path} has no points')
    if not table.columns and len(table.rows[0]) not in (3, 6):
        raise InputError(f'{path} has {counted(len(table.rows[0]), "column")} and no header: '
                         'name them in the first line (x,y,z ...)')
    return table


def _recording(table: Table, name: str, scale: float) -> Recording:
    """Turn a table of points into a recording."""
    time, quality = table.first_of('t', 'time', 'stamp'), table.first_of('quality', 'error')
    return Recording(
        positions=table.numbers(*(XYZ if table.columns else range(3))) * scale,
        stamps=None if time is None else _finite(table, time),
        frame_ids=table.text('frame_id') if 'frame_id' in table.columns else '',
        source_names=[name],
        quality=None if quality is None else table.numbers(quality)[:, 0] * scale,
        strokes=_whole(table, 'stroke') if 'stroke' in table.columns else None)


def _finite(table: Table, column: str) -> Array:
    """Return a column that must have a finite number on every line."""
    values = table.numbers(column)[:, 0]
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise InputError(
            f'{table.path}, line {table.lines[bad[0]]}: the {column} is empty or not finite')
    return values


def _whole(table: Table, column: str) -> NDArray[np.int32]:
    """Return a column of whole numbers."""
    values = _finite(table, column)
    bad = np.flatnonzero((values != np.round(values)) | (np.abs(values) > 2**31 - 1))
    if len(bad):
        raise InputError(
            f'{table.path}, line {table.lines[bad[0]]}: the {column} is no whole number')
    return values.astype(np.int32)


def read_landmarks(path: str | os.PathLike[str], model_unit: str, unit: str) -> Landmarks:
    """
    Read pairs of landmarks from CSV.

    Its header: ``name,model_x,model_y,model_z,tracker_x,tracker_y,tracker_z``.

    Parameters
    ----------
    path : path
        Of the file.
    model_unit, unit : {'mm', 'm'}
        Of the model and of the tracker columns.

    Returns
    -------
    Landmarks
        In metres.

    Raises
    ------
    InputError
        If a column is missing, a number is missing or not finite, a name stands twice, or there are
        no rows.

    """
    model_names, tracker_names = ([f'{side}_{axis}' for axis in XYZ]
                                  for side in ('model', 'tracker'))
    table = read_table(path)
    missing = [name for name in ('name', *model_names, *tracker_names) if name not in table.columns]
    if missing:
        raise InputError(
            f'{path}: landmarks need the column{"s" * (len(missing) > 1)} {", ".join(missing)}')
    if not table.rows:
        raise InputError(f'{path} has no landmarks')
    names = table.text('name')
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f'{path}: the landmark {twice!r} stands there twice')
    model, tracker = (np.column_stack([_finite(table, name) for name in side])
                      for side in (model_names, tracker_names))
    return Landmarks(names, model * metres_per(model_unit), tracker * metres_per(unit))
