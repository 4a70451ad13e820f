# SPDX-License-Identifier: Apache-2.0
"""
Read and write point lists of 3D Slicer: markups (.mrk.json), fiducials (.fcsv) and tables (.csv).

The lengths are in millimetres unless the file states another unit. A list states its coordinate
system: LPS (x to the left, y to the back of the patient, z to the head), as in DICOM and in most
files, or RAS (x to the right, y to the front), as Slicer shows positions. They differ in the sign
of x and y. Formats: developer guide of 3D Slicer, Markups.
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import MAX_COORDINATE, Array
from msg_adapters.files import read_json, read_text, write_atomically
from msg_adapters.segmentation import is_segmentation
from msg_adapters.table import read_table
from msg_adapters.vtk_mesh import vtk_axes

AXES = ('lps', 'ras')
FLIP = np.array([-1.0, -1.0, 1.0])      # between LPS and RAS
SCHEMA = ('https://raw.githubusercontent.com/Slicer/Slicer/main/Modules/Loadable/Markups/Resources/'
          'Schema/markups-schema-v1.0.3.json#')
FCSV_COLUMNS = 'id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID'
FCSV_AXES = {'0': 'ras', '1': 'lps', 'ras': 'ras', 'lps': 'lps'}    # 2, IJK, needs the image
TABLE_AXES = {('r', 'a', 's'): 'ras', ('l', 'p', 's'): 'lps'}
UNITS = {'mm': 1e-3, 'um': 1e-6, 'm': 1.0}      # m
HEADER = 4096       # bytes at the start of a model in which Slicer states the coordinate system


class PointList(NamedTuple):
    """
    Named points.

    name : of the list; empty: it has none
    labels : of k points
    positions : (k, 3) float64, m
    """

    name: str
    labels: list[str]
    positions: Array


def is_point_list(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a point list of Slicer, by its name, or the first lines of a CSV."""
    return _kind(path) is not None


def read_point_lists(path: str | os.PathLike[str], axes: str = 'lps') -> list[PointList]:
    """
    Read the point lists of a file; points without a position are left out.

    Parameters
    ----------
    path : path
        .mrk.json, which can have several lists, .fcsv, or an exported table (.csv).
    axes : {'lps', 'ras'}
        Coordinate system of the result.

    Raises
    ------
    InputError
        If the file cannot be read, has another format, no points, or another coordinate system
        than LPS and RAS.

    """
    kind = _kind(path)
    lists = (_read_markups(path, axes) if kind == '.mrk.json' else
             [_read_fcsv(path, axes) if kind == '.fcsv' else _read_table(path, axes)])
    if not any(each.labels for each in lists):
        raise InputError(f'{path} has no points with a position')
    return [each for each in lists if each.labels]


def check_point_list_path(path: str | os.PathLike[str]) -> None:
    """Raise `InputError` if a point list cannot be written under this name."""
    if not str(path).lower().endswith(('.mrk.json', '.fcsv')):
        raise InputError(f'{path}: a point list of Slicer has the ending .mrk.json or .fcsv')


def write_point_lists(path: str | os.PathLike[str], lists: Sequence[PointList],
                      axes: str = 'lps') -> None:
    """
    Write point lists; .fcsv has one list, so that it holds the points of all.

    Parameters
    ----------
    path : path
        .mrk.json or .fcsv.
    lists : of points in ``axes``, m
    axes : {'lps', 'ras'}

    Raises
    ------
    InputError
        If the name has another ending, or the file cannot be written.

    """
    check_point_list_path(path)
    if str(path).lower().endswith('.fcsv'):
        rows = [[f'{i}', *(f'{1e3 * value:.9g}' for value in position), '0', '0', '0', '1', '1',
                 '1', '0', _quoted(label), '', '']
                for i, (label, position) in enumerate(
                    (label, position) for each in lists
                    for label, position in zip(each.labels, each.positions.tolist()))]
        text = '\n'.join(['# Markups fiducial file version = 5.6',
                          f'# CoordinateSystem = {axes.upper()}', f'# columns = {FCSV_COLUMNS}',
                          *(','.join(row) for row in rows)]) + '\n'
    else:
        text = json.dumps({'@schema': SCHEMA, 'markups': [_markup(each, axes) for each in lists]},
                          indent=1) + '\n'
    write_atomically(path, text)


def only_list(path: str | os.PathLike[str], axes: str) -> PointList:
    """Return the points of a file that has one list; errors as in `read_point_lists`."""
    lists = read_point_lists(path, axes)
    if len(lists) > 1:
        raise InputError(f'{path} has {len(lists)} point lists; save one of them in a file')
    return lists[0]


def model_axes(path: str | os.PathLike[str]) -> str | None:
    """
    Return the coordinate system that a model file states, None if it states none.

    Slicer writes SPACE=LPS or SPACE=RAS into the header of its models. A segmentation is in LPS.
    """
    if is_segmentation(path):
        return 'lps'
    if str(path).lower().endswith('.vtp'):
        return vtk_axes(Path(path))
    with open(path, 'rb') as file:
        found = re.search(rb'SPACE\s*=\s*(LPS|RAS)\b', file.read(HEADER), re.IGNORECASE)
    return found.group(1).decode().lower() if found else None


def converted(positions: Array, source: str, wanted: str) -> Array:
    """Return positions (n, 3) in the axes ``wanted``."""
    return positions if source == wanted else positions * FLIP


def _kind(path: str | os.PathLike[str]) -> str | None:
    """Return .mrk.json, .fcsv or .csv for the formats of Slicer, None for any other file."""
    name = str(path).lower()
    named = next((kind for kind in ('.mrk.json', '.fcsv') if name.endswith(kind)), None)
    if named or not name.endswith(('.csv', '.tsv')) or not os.path.isfile(path):
        return named
    with open(path, 'rb') as file:
        start = file.read(HEADER).decode('utf-8', 'replace').lstrip('\ufeff').lower()
    if start.startswith('# markups fiducial'):      # renamed
        return '.fcsv'
    columns = set(re.split('[,\t]', start.partition('\n')[0].strip()))
    return '.csv' if any({'label', *axis_names} <= columns for axis_names in TABLE_AXES) else None


def _read_markups(path: str | os.PathLike[str], axes: str) -> list[PointList]:
    try:
        markups = read_json(path)['markups']
        if not isinstance(markups, list):
            raise TypeError
        return [_point_list(path, markup, axes) for markup in markups]
    except (KeyError, TypeError, AttributeError):
        raise InputError(f'{path} has no markups: it needs "markups" with "controlPoints", as '
                         'Slicer writes it') from None


def _point_list(path: str | os.PathLike[str], markup: Any, axes: str) -> PointList:
    """Return one list of a markups file."""
    source = str(markup.get('coordinateSystem', 'LPS')).lower()     # default of the schema
    if source not in AXES:
        raise InputError(f'{path}: the coordinate system {source.upper()!r} is not known; save the '
                         'points in LPS or RAS')
    unit = markup.get('coordinateUnits', 'mm')
    unit = unit[0] if isinstance(unit, list) and unit else unit     # a code of DICOM
    if unit not in UNITS:
        raise InputError(f'{path}: the unit {unit!r} is not known; save the points in mm')
    labels: list[str] = []
    positions = []
    for i, point in enumerate(markup['controlPoints'], start=1):
        if str(point.get('positionStatus', 'defined')) != 'defined':
            continue
        labels.append(str(point.get('label') or i))
        positions.append(_position(path, labels[-1], point['position']))
    return PointList(str(markup.get('name', '')), labels,
                     converted(np.array(positions).reshape(-1, 3) * UNITS[unit], source, axes))


def _read_fcsv(path: str | os.PathLike[str], axes: str) -> PointList:
    source, columns = 'ras', FCSV_COLUMNS.split(',')    # before version 4.6, RAS was not stated
    labels: list[str] = []
    positions = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.startswith('#'):
            key, _, value = line.lstrip('# ').partition('=')
            if key.strip().lower().replace(' ', '') == 'coordinatesystem':
                source = FCSV_AXES.get(value.strip().lower(), '')
                if not source:
                    raise InputError(f'{path}, line {number}: the coordinate system '
                                     f'{value.strip()!r} is not known; save the points in LPS or '
                                     'RAS')
            elif key.strip() == 'columns':
                columns = [name.strip() for name in value.split(',')]
        elif line.strip():
            cells = dict(zip(columns, next(csv.reader([line]))))
            label = cells.get('label') or str(len(labels) + 1)
            labels.append(label)
            positions.append(_position(f'{path}, line {number}', label,
                                       [cells.get(axis) for axis in 'xyz']))
    return PointList('', labels,
                     converted(np.array(positions).reshape(-1, 3) * UNITS['mm'], source, axes))


def _read_table(path: str | os.PathLike[str], axes: str) -> PointList:
    """Return the points of a table with the columns label and r,a,s or l,p,s."""
    table = read_table(path)
    names = next(names for names in TABLE_AXES if set(names) <= set(table.columns))
    rows = [row for row in range(len(table.rows))
            if 'defined' not in table.columns or table.text('defined')[row] != '0']
    labels = table.text('label')
    positions = [_position(f'{path}, line {table.lines[row]}', labels[row], values)
                 for row, values in enumerate(table.numbers(*names).tolist()) if row in rows]
    return PointList('', [labels[row] for row in rows],
                     converted(np.array(positions).reshape(-1, 3) * UNITS['mm'],
                               TABLE_AXES[names], axes))


def _position(where: str | os.PathLike[str], label: str, values: Any) -> list[float]:
    """Return three finite numbers."""
    try:
        position = [float(value) for value in values]
    except (TypeError, ValueError):
        position = []
    if len(position) != 3 or not (np.abs(position) < 1e3 * MAX_COORDINATE).all():
        raise InputError(f'{where}: the position of {label!r} is not three finite numbers')
    return position


def _markup(points: PointList, axes: str) -> dict[str, Any]:
    """Return a list as an element of a markups file."""
    return {
        'type': 'Fiducial', 'name': points.name, 'coordinateSystem': axes.upper(),
        'coordinateUnits': 'mm',
        'controlPoints': [{'id': str(i), 'label': label, 'position': position,
                           'positionStatus': 'defined'}
                          for i, (label, position) in enumerate(
                              zip(points.labels, (1e3 * points.positions).tolist()), start=1)]}


def _quoted(label: str) -> str:
    """Return a label as a cell of a CSV file."""
    return '"' + label.replace('"', '""') + '"' if re.search('[,"]', label) else label
