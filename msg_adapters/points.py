# SPDX-License-Identifier: Apache-2.0
"""
Read bone models, touched points and landmarks from files.

Units are explicit: the caller passes the unit of a file.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters import ndi, slicer
from msg_adapters.files import readable_file, unit_scale
from msg_adapters.mesh import load_surface
from msg_adapters.motion import ORIENTATION, POSITION
from msg_adapters.recording import Recording
from msg_adapters.segmentation import is_segmentation, read_segmentation
from msg_adapters.table import Table, read_table
from msg_adapters.vtk_mesh import VTK_FILES, load_vtk

MESHES = ('.stl', '.ply', '.obj', '.off', '.3mf', '.glb')
TEXTS = ('.csv', '.tsv', '.txt', '.xyz')
XYZ = ('x', 'y', 'z')
POSE = (*POSITION, *ORIENTATION)
NORMAL = ('nx', 'ny', 'nz')


def read_model(path: str | os.PathLike[str], unit: str,
               label: str = '') -> tuple[Array, NDArray[np.int32] | None, Array | None]:
    """
    Read the surface of a bone, a mesh or a point cloud with normals, without repair.

    STL, PLY, OBJ, OFF, 3MF, GLB, VTK and VTP files are meshes; several bodies are merged. A PLY
    file without faces, XYZ and CSV files are point clouds, with normals in ``nx, ny, nz`` or in the
    last three of six columns. NIfTI, NRRD, MetaImage and DICOM SEG files are segmentations.

    Parameters
    ----------
    path : path
        File to read.
    unit : {'mm', 'm'}
        Unit of length of the file.
    label : str
        Number or name of the bone in a segmentation; empty: the only one.

    Returns
    -------
    vertices : (n, 3) float64, m, bone frame
    faces : (m, 3) int32, or None for a point cloud
    normals : (n, 3) float64, or None for a mesh

    Raises
    ------
    InputError
        If the file is missing, damaged, truncated or of unknown type, or has neither faces nor
        normals, or the label is missing or ambiguous.

    """
    scale = unit_scale(unit)
    path = readable_file(path)
    kind = path.suffix.lower()
    if is_segmentation(path):
        if unit != 'mm':
            raise InputError(f'{path} is a segmentation, which is in mm; set the unit of the model '
                             'to mm')
        return (*read_segmentation(path, label), None)
    if label:
        raise InputError(f'{path} is no segmentation: omit --label (model.label)')
    if kind in VTK_FILES:
        vertices, faces, normals = load_vtk(path)
    elif kind in MESHES:
        vertices, faces, normals = load_surface(path)
    elif kind in TEXTS:
        table = _points_table(path)
        named = bool(table.columns)
        has_normals = set(NORMAL) <= set(table.columns) if named else len(table.rows[0]) == 6
        vertices, faces = table.numbers(*(XYZ if named else range(3))), None
        normals = table.numbers(*(NORMAL if named else range(3, 6))) if has_normals else None
    else:
        raise InputError(
            f'{path}: a model must be a mesh (STL, PLY, OBJ, OFF, 3MF, GLB, VTK, VTP), a '
            'segmentation (NIfTI, NRRD, DICOM SEG), or points with normals as PLY, XYZ or CSV')
    if faces is None and normals is None:
        raise InputError(
            f'{path} has neither faces nor normals; use a mesh, or points with nx, ny, nz')
    if not np.isfinite(vertices).all() or (normals is not None and not np.isfinite(normals).all()):
        raise InputError(f'{path} has coordinates that are not finite; export the model again')
    return vertices * scale, faces, normals


def read_points(path: str | os.PathLike[str], unit: str, tool: str | None = None,
                axes: str = 'lps', poses: bool = False) -> Recording:
    """
    Read touched points.

    The file is one of the following.

    - CSV, TXT or XYZ with a header with x, y, z in any order, and optionally t/time/stamp in
      seconds, quality/error in ``unit``, stroke and frame_id
    - the same with tx, ty, tz, qx, qy, qz, qw instead of x, y, z: poses of a tool
    - CSV, TXT or XYZ with columns x y z and no header
    - PLY
    - NDI tracker CSV, detected by its header
    - point list of 3D Slicer, .mrk.json or .fcsv

    Parameters
    ----------
    path : path
        File to read.
    unit : {'mm', 'm'}
        Unit of length of the file.
    tool : str, optional
        Part of the port label of the tool, for an NDI tracker CSV with several tools.
    axes : {'lps', 'ras'}
        Axes of the result, if the file states its own.
    poses : bool, optional
        Whether an NDI tracker CSV has the poses of a tool; else it has the positions of its tip.

    Returns
    -------
    Recording
        In metres; rows with coordinates that are empty or not finite are kept, and rejected later.

    Raises
    ------
    InputError
        If the file has another format or no points; the message names the line.

    """
    scale = unit_scale(unit)
    path = readable_file(path)
    kind = path.suffix.lower()
    known = slicer.is_point_list(path) or (kind in TEXTS and ndi.is_ndi(path))
    if known and unit != 'mm':
        what = 'a point list of Slicer' if slicer.is_point_list(path) else 'an NDI tracker CSV'
        raise InputError(f'{path} is {what}, which is in mm; set the unit to mm')
    if slicer.is_point_list(path):
        lists = slicer.read_point_lists(path, axes)
        return Recording(np.concatenate([each.positions for each in lists]),
                         source_names=[path.name])
    if known:
        return ndi.read_ndi(path, tool, poses=poses)
    if tool is not None:
        raise InputError(f'{path} is no NDI tracker CSV: omit --tool')
    if kind == '.ply':
        surface = load_surface(path)
        if surface.faces is not None:
            raise InputError(f'{path} has faces; touched points must be a PLY file without faces')
        return Recording(surface.vertices * scale, source_names=[path.name])
    if kind not in TEXTS:
        raise InputError(
            f'{path}: points must be a CSV, TXT or XYZ file with x, y, z, a PLY file, an NDI '
            'tracker CSV, or a point list of Slicer (.mrk.json, .fcsv)')
    return _recording(_points_table(path), path.name, scale)


def _points_table(path: Path) -> Table:
    """Read a table with columns x, y, z, or with three or six columns and no header."""
    table = read_table(path, wanted=XYZ)
    if table.columns and not any(set(names) <= set(table.columns) for names in (XYZ, POSE)):
        raise InputError(f'{path}: the columns {", ".join(table.columns)} do not include x, y, z')
    if not table.rows:
        raise InputError(f'{path} has no points')
    if not table.columns and len(table.rows[0]) not in (3, 6):
        raise InputError(f'{path} has {format_count(len(table.rows[0]), "column")} and no header; '
                         'add the names of the columns as the first line (x,y,z ...)')
    return table


def _recording(table: Table, name: str, scale: float) -> Recording:
    """Convert a table of points to a recording."""
    time, quality = table.first_of('t', 'time', 'stamp'), table.first_of('quality', 'error')
    tools = None
    if set(POSE) <= set(table.columns):
        tools = table.numbers(*POSE) * np.array(3 * [scale] + 4 * [1.0])
    return Recording(
        positions=(table.numbers(*(XYZ if table.columns else range(3))) * scale if tools is None
                   else tools[:, :3]),
        tools=tools,
        stamps=None if time is None else _finite(table, time),
        frame_ids=table.text('frame_id') if 'frame_id' in table.columns else '',
        source_names=[name],
        quality=None if quality is None else table.numbers(quality)[:, 0] * scale,
        strokes=_whole(table, 'stroke') if 'stroke' in table.columns else None)


def _finite(table: Table, column: str) -> Array:
    """Return a column; raise `InputError` if a value is not finite."""
    values = table.numbers(column)[:, 0]
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise InputError(
            f'{table.path}, line {table.lines[bad[0]]}: the {column} is empty or not finite')
    return values


def _whole(table: Table, column: str) -> NDArray[np.int32]:
    """Return a column of whole numbers; raise `InputError` for other values."""
    values = _finite(table, column)
    bad = np.flatnonzero((values != np.round(values)) | (np.abs(values) > 2**31 - 1))
    if len(bad):
        raise InputError(
            f'{table.path}, line {table.lines[bad[0]]}: the {column} is not a whole number')
    return values.astype(np.int32)


def read_landmarks(path: str | os.PathLike[str], model_unit: str, unit: str) -> Landmarks:
    """
    Read pairs of landmarks from CSV.

    The header is ``name,model_x,model_y,model_z,tracker_x,tracker_y,tracker_z``, and optionally
    ``sigma``, the standard deviation of a landmark along each axis, in the unit of the tracker; 0
    or an empty field: not known.

    Parameters
    ----------
    path : path
        File to read.
    model_unit, unit : {'mm', 'm'}
        Units of length of the model and of the tracker columns.

    Returns
    -------
    Landmarks
        In metres.

    Raises
    ------
    InputError
        If a column is missing, a number is missing or not finite, a standard deviation is negative,
        a name is duplicate, or there are no rows.

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
    duplicate = next((name for name in names if names.count(name) > 1), None)
    if duplicate is not None:
        raise InputError(f'{path}: the landmark {duplicate!r} is not unique')
    model, tracker = (np.column_stack([_finite(table, name) for name in side])
                      for side in (model_names, tracker_names))
    return Landmarks(tuple(names), model * unit_scale(model_unit), tracker * unit_scale(unit),
                     _sigmas(table) * unit_scale(unit))


def _sigmas(table: Table) -> Array:
    """Return the column of standard deviations (k,) of a table of landmarks; zeros without it."""
    if 'sigma' not in table.columns:
        return np.zeros(len(table.rows))
    sigmas = np.nan_to_num(table.numbers('sigma')[:, 0], nan=0.0, posinf=np.inf)
    bad = np.flatnonzero(~(np.isfinite(sigmas) & (sigmas >= 0.0)))
    if len(bad):
        raise InputError(f'{table.path}, line {table.lines[bad[0]]}: the sigma of a landmark must '
                         'be 0 or empty (not known), or a positive number')
    return sigmas
