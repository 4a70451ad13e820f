# SPDX-License-Identifier: Apache-2.0
"""Test reading and writing of point lists of 3D Slicer."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gsdf_registration.common.result import InputError
from msg_adapters.points import read_points
from msg_adapters.slicer import (
    PointList,
    is_point_list,
    model_axes,
    only_list,
    read_point_lists,
    write_point_lists,
)

LABELS = ['head', 'lateral "epicondyle", left', 'medial']
# mm; different in all axes
LPS = np.array([[10.5, -20.25, 30.125], [-1.0, 2.0, -3.0], [100.0, 200.0, -300.5]])
RAS = LPS * [-1, -1, 1]
FCSV = """# Markups fiducial file version = {version}
# CoordinateSystem = {axes}
# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
vtkMRMLMarkupsFiducialNode_0,{p[0]},{p[1]},{p[2]},0,0,0,1,1,1,0,head,,
"""


def markups(axes: str, positions: np.ndarray, **more: object) -> dict[str, object]:
    points = [{'label': label, 'position': position}
              for label, position in zip(LABELS, positions.tolist())]
    return {'markups': [{'type': 'Fiducial', 'coordinateSystem': axes, 'controlPoints': points,
                         **more}]}


def write(path: Path, content: object) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize('name', ['points.mrk.json', 'points.fcsv'])
@pytest.mark.parametrize('axes', ['lps', 'ras'])
def test_what_is_written_is_read_in_both_coordinate_systems(tmp_path: Path, name: str,
                                                            axes: str) -> None:
    path = tmp_path / name
    write_point_lists(path, [PointList('landmarks', LABELS, 1e-3 * LPS)], axes)
    found = only_list(path, axes)
    assert found.labels == LABELS and is_point_list(path)
    np.testing.assert_allclose(found.positions, 1e-3 * LPS, rtol=1e-9)
    other = 'ras' if axes == 'lps' else 'lps'
    np.testing.assert_allclose(only_list(path, other).positions, 1e-3 * RAS, rtol=1e-9)


def test_the_coordinate_system_of_markups_is_honoured(tmp_path: Path) -> None:
    for axes, positions in (('LPS', LPS), ('RAS', RAS)):
        path = write(tmp_path / f'{axes}.mrk.json', markups(axes, positions))
        np.testing.assert_allclose(only_list(path, 'lps').positions, 1e-3 * LPS)
        np.testing.assert_allclose(only_list(path, 'ras').positions, 1e-3 * RAS)


@pytest.mark.parametrize(('axes', 'version', 'source'), [
    ('LPS', '5.6', 'lps'), ('1', '4.11', 'lps'), ('0', '4.10', 'ras'), ('RAS', '4.11', 'ras')])
def test_the_coordinate_system_of_fcsv_is_honoured(tmp_path: Path, axes: str, version: str,
                                                   source: str) -> None:
    text = FCSV.format(axes=axes, version=version, p=LPS[0] if source == 'lps' else RAS[0])
    # a renamed file is the same list
    for name in ('f.fcsv', 'f.csv'):
        found = only_list(write(tmp_path / name, text), 'lps')
        assert found.labels == ['head']
        np.testing.assert_allclose(found.positions, 1e-3 * LPS[:1])


def test_an_exported_table_names_its_axes(tmp_path: Path) -> None:
    for header, positions in (('label,r,a,s,defined', RAS), ('label,l,p,s,defined', LPS)):
        rows = [f'{label},{x},{y},{z},1' for label, (x, y, z) in zip('abc', positions)]
        path = write(tmp_path / 't.csv', '\n'.join([header, *rows, 'd,0,0,0,0']))
        assert is_point_list(path) and only_list(path, 'lps').labels == ['a', 'b', 'c']
        np.testing.assert_allclose(only_list(path, 'lps').positions, 1e-3 * LPS)
    assert not is_point_list(write(tmp_path / 'p.csv', 'x,y,z\n1,2,3\n'))


def test_points_without_a_position_are_left_out(tmp_path: Path) -> None:
    document = markups('LPS', LPS)
    document['markups'][0]['controlPoints'][1]['positionStatus'] = 'undefined'     # type: ignore
    found = only_list(write(tmp_path / 'p.mrk.json', document), 'lps')
    assert found.labels == [LABELS[0], LABELS[2]]


@pytest.mark.parametrize(('unit', 'scale'), [
    ('mm', 1e-3), ('um', 1e-6), (['mm', 'UCUM', 'millimeter'], 1e-3)])
def test_the_unit_of_markups_is_honoured(tmp_path: Path, unit: object, scale: float) -> None:
    path = write(tmp_path / 'p.mrk.json', markups('LPS', LPS, coordinateUnits=unit))
    np.testing.assert_allclose(only_list(path, 'lps').positions, scale * LPS)


@pytest.mark.parametrize(('name', 'content', 'words'), [
    ('a.mrk.json', '{', 'line 1: this is not valid JSON'),
    ('a.mrk.json', {'markups': 3}, 'has no markups'),
    ('a.mrk.json', [1], 'has no markups'),
    ('a.mrk.json', {'markups': [{'controlPoints': []}]}, 'no points with a position'),
    ('a.mrk.json', markups('HFS', LPS), "the coordinate system 'HFS' is not known"),
    ('a.mrk.json', markups('LPS', LPS[:, :2]), "the position of 'head' is not three"),
    ('a.mrk.json', markups('LPS', LPS, coordinateUnits='inch'), 'inch'),
    ('a.fcsv', FCSV.format(axes='2', version='4', p=LPS[0]), "line 2: the coordinate system '2'"),
    ('a.fcsv', FCSV.format(axes='LPS', version='4', p='xyz'), 'line 4'),
    ('a.fcsv', '# Markups fiducial file version = 5.6\n', 'no points with a position'),
])
def test_message_names_the_defect(tmp_path: Path, name: str, content: object, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_point_lists(write(tmp_path / name, content))
    message = caught.value.message
    assert words in message and name in message and '\n' not in message


def test_one_list_is_asked_for_where_one_is_needed(tmp_path: Path) -> None:
    path = tmp_path / 'two.mrk.json'
    write_point_lists(path, [PointList(name, LABELS, LPS) for name in 'ab'])
    with pytest.raises(InputError, match='has 2 point lists'):
        only_list(path, 'lps')
    with pytest.raises(InputError, match='has the ending .mrk.json or .fcsv'):
        write_point_lists(tmp_path / 'a.json', [])


def test_a_point_list_is_read_as_points(tmp_path: Path) -> None:
    path = write(tmp_path / 'p.mrk.json', markups('LPS', LPS))
    np.testing.assert_allclose(read_points(path, 'mm').positions, 1e-3 * LPS)
    np.testing.assert_allclose(read_points(path, 'mm', axes='ras').positions, 1e-3 * RAS)
    with pytest.raises(InputError, match='point list of Slicer, which is in mm'):
        read_points(path, 'm')


@pytest.mark.parametrize(('header', 'axes'), [
    ('solid 3D Slicer output. SPACE=LPS\n', 'lps'), ('# SPACE=RAS\n', 'ras'), ('solid a\n', None)])
def test_the_axes_that_a_model_states_are_found(tmp_path: Path, header: str,
                                                axes: str | None) -> None:
    assert model_axes(write(tmp_path / 'm.stl', header)) == axes
