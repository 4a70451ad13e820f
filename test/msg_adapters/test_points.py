# SPDX-License-Identifier: Apache-2.0
"""Test reading of models, points and landmarks."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refusal

from msg_adapters.points import read_landmarks, read_model, read_points

BOX = trimesh.creation.box(extents=[40.0, 60.0, 80.0])
CLOUD_PLY = """ply
format ascii 1.0
element vertex 2
property float x
property float y
property float z
property float nx
property float ny
property float nz
end_header
1 2 3 1 0 0
4 5 6 0 1 0
"""


def export(path, mesh=BOX, **options):
    data = mesh.export(file_type=options.pop('file_type', path.suffix[1:]), **options)
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def write(path, text):
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def corners(vertices, faces):
    return np.sort(np.linalg.norm(vertices[faces].reshape(-1, 3), axis=1))


@pytest.mark.parametrize('name, options', [
    ('box.stl', {}), ('box.STL', {'file_type': 'stl_ascii'}), ('box.ply', {}),
    ('box.PLY', {'file_type': 'ply', 'encoding': 'ascii'}), ('box.obj', {}), ('box.off', {}),
    ('box.glb', {}),
    pytest.param('box.3mf', {}, marks=pytest.mark.skipif(
        importlib.util.find_spec('lxml') is None, reason='lxml is not installed')),
])
@pytest.mark.parametrize('unit, scale', [('mm', 0.001), ('m', 1.0)])
def test_reads_meshes_in_metres(tmp_path, name, options, unit, scale):
    vertices, faces, normals = read_model(export(tmp_path / name, **options), unit)
    assert vertices.dtype == np.float64 and faces.dtype == np.int32 and normals is None
    assert faces.shape == (12, 3)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), np.array([40, 60, 80]) * scale, rtol=1e-6)
    np.testing.assert_allclose(corners(vertices, faces),
                               corners(BOX.vertices, BOX.faces) * scale,
                               rtol=1e-6)


def test_merges_several_bodies(tmp_path):
    text = ('o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n'
            'o b\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf 4 5 6\n')
    vertices, faces, _ = read_model(write(tmp_path / 'two.obj', text), 'm')
    assert len(faces) == 2
    assert sorted(vertices[faces].mean(axis=1)[:, 2].tolist()) == [0, 5]
    solids = export(tmp_path / 'a.stl', file_type='stl_ascii').read_text()
    _, faces, _ = read_model(write(tmp_path / 'two.stl', f'{solids}\n{solids}'), 'mm')
    assert len(faces) == 24


def test_triangulates_polygons(tmp_path):
    quad = write(tmp_path / 'quad.off',
                 'OFF\n5 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n4 0 1 2 3\n3 0 1 4\n')
    assert read_model(quad, 'm')[1].shape == (3, 3)


def test_does_not_repair_a_surface(tmp_path):
    text = 'OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 0\n3 0 1 2\n3 3 3 3\n'
    vertices, faces, _ = read_model(write(tmp_path / 'poor.off', text), 'm')
    assert len(vertices) == 4 and len(faces) == 2


@pytest.mark.parametrize('name, text', [
    ('cloud.ply', CLOUD_PLY),
    ('cloud.csv', 'NX, ny,nz,x,Y,z\n1,0,0,1,2,3\n0,1,0,4,5,6\n'),
    ('cloud.xyz', '1 2 3 1 0 0\n4 5 6 0 1 0\n'),
])
def test_reads_clouds_with_normals(tmp_path, name, text):
    vertices, faces, normals = read_model(write(tmp_path / name, text), 'mm')
    assert faces is None
    np.testing.assert_allclose(vertices, [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006]])
    np.testing.assert_array_equal(normals, [[1, 0, 0], [0, 1, 0]])      # directions have no unit


def test_reads_the_normals_of_a_binary_ply_cloud(tmp_path):
    rows = np.array([(1, 2, 3, 1, 0, 0), (4, 5, 6, 0, 1, 0)], '<f4')
    head = CLOUD_PLY.partition('end_header\n')[0].replace('ascii',
                                                          'binary_little_endian') + 'end_header\n'
    vertices, _, normals = read_model(write(tmp_path / 'c.ply',
                                            head.encode() + rows.tobytes()), 'm')
    np.testing.assert_array_equal(np.hstack([vertices, normals]), rows)


def test_rejects_files_that_are_not_models(tmp_path):
    assert 'does not exist' in refusal(read_model, tmp_path / 'none.stl', 'mm')
    assert 'directory' in refusal(read_model, tmp_path, 'mm')
    for suffix in ('stl', 'ply', 'obj', 'off', 'csv'):
        assert 'is empty' in refusal(read_model, write(tmp_path / f'e.{suffix}', ''), 'mm')
    assert 'STL, PLY, OBJ, OFF' in refusal(read_model, write(tmp_path / 'a.step', 'x'), 'mm')
    assert 'cm' in refusal(read_model, export(tmp_path / 'a.stl'), 'cm')
    assert 'normals' in refusal(read_model, write(tmp_path / 'a.xyz', '1 2 3\n'), 'mm')
    assert 'normals' in refusal(read_model, write(tmp_path / 'a.obj',
                                                  'v 0 0 0\nv 1 0 0\nv 0 1 0\n'), 'mm')


@pytest.mark.parametrize('suffix', ['stl', 'ply', 'obj', 'off'])
def test_rejects_damaged_files_and_nan(tmp_path, suffix):
    garbage = write(tmp_path / f'g.{suffix}', b'\x00\xff no model at all\n' * 9)
    assert str(garbage) in refusal(read_model, garbage, 'mm')
    nan = trimesh.Trimesh(BOX.vertices.copy(), BOX.faces, process=False)
    nan.vertices[3, 1] = np.nan
    assert refusal(read_model, export(tmp_path / f'n.{suffix}', nan), 'mm')


def test_rejects_faces_with_unknown_vertices(tmp_path):
    off = 'OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 {}\n'
    for bad in (3, -1):
        assert refusal(read_model, write(tmp_path / 'a.off', off.format(bad)), 'mm')
    assert refusal(read_model, write(tmp_path / 'a.obj', 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n'),
                   'mm')


@pytest.mark.parametrize('suffix, options', [
    ('stl', {}), ('stl', {'file_type': 'stl_ascii'}), ('ply', {}), ('ply', {'encoding': 'ascii'}),
    ('off', {}),
])
@pytest.mark.parametrize('share', [0.2, 0.5, 0.8, 0.97, 0.993])
def test_rejects_truncated_files(tmp_path, suffix, options, share):
    path = export(tmp_path / f'whole.{suffix}', trimesh.creation.icosphere(2, 30.0), **options)
    content = path.read_bytes()
    path.write_bytes(content[:int(share * len(content))])
    message = refusal(read_model, path, 'mm')
    assert 'truncated' in message or 'damaged' in message


def test_rejects_an_stl_file_of_the_wrong_length(tmp_path):
    solid = export(tmp_path / 'a.stl', file_type='stl_ascii').read_text()
    two = solid + '\n' + solid
    assert 'truncated' in refusal(read_model, write(tmp_path / 'b.stl', two[:-100]), 'mm')
    binary = export(tmp_path / 'c.stl').read_bytes()
    assert 'triangles' in refusal(read_model, write(tmp_path / 'd.stl', binary + b'more'), 'mm')


def test_rejects_an_obj_file_with_an_incomplete_line(tmp_path):
    text = export(tmp_path / 'a.obj').read_text().rstrip()
    assert 'incomplete' in refusal(read_model, write(tmp_path / 'b.obj', text[:text.rindex(' ')]),
                                   'mm')
    assert len(read_model(write(tmp_path / 'c.obj', text.replace('\n', '\r\n')), 'mm')[1]) == 12


@pytest.mark.parametrize('text', [
    'x,y,z\n1,2,3\n4,5,6\n',
    'X, Y ,Z\r\n1, 2, 3\r\n4, 5, 6\r\n',
    '\ufeffx;y;z\n1;2;3\n\n4;5;6\n',
    '# touched by hand\nz\ty\tx\n3\t2\t1\n# half way\n6\t5\t4\n',
    '1 2 3\n  4   5 6\n',
    '# x y z\n1 2 3\n4 5 6',
    '"x","y","z"\n"1","2","3"\n4,5,6\n',
    'x,y,z,\n1,2,3,\n4,5,6,\n',
    'name,x,y,z\nfirst,1,2,3\nsecond one,4,5,6\n',
    '1,2,3,0,0,1\n4,5,6,0,0,1\n',
])
def test_reads_points_in_common_formats(tmp_path, text):
    points = read_points(write(tmp_path / 'p.csv', text), 'mm')
    np.testing.assert_allclose(points.positions, [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006]])
    assert points.stamps is None and points.strokes is None and points.quality is None
    assert points.source_names == ['p.csv']


def test_reads_all_optional_columns(tmp_path):
    text = 'frame_id,Time,x,y,z,stroke,Quality\ntracker,0.5,1,2,3,0,0.25\narray,1.5,4,5,6,1,\n'
    points = read_points(write(tmp_path / 'p.txt', text), 'mm')
    assert points.stamps.tolist() == [0.5, 1.5]
    assert points.frame_ids == ['tracker', 'array'] and points.strokes.tolist() == [0, 1]
    np.testing.assert_allclose(points.quality, [0.00025, np.nan])


def test_keeps_rows_that_are_not_finite(tmp_path):
    points = read_points(write(tmp_path / 'p.csv', 'x,y,z\n1,2,3\nnan,2,3\n,,\n1,inf,0\n'), 'm')
    assert np.isfinite(points.positions).all(axis=1).tolist() == [True, False, False, False]


@pytest.mark.parametrize('text, words', [
    ('x,y,z\n1,2,3\n1,two,3\n', ['line 3', "'two'"]),
    ('x;y;z\n1,5;2;3\n', ['line 2', 'decimal point']),
    ('x,y,z\n\n# skip\n1,2\n', ['line 4', '2 values where 3']),
    ('x,y,z\n1,2,3,4\n', ['line 2', '4 values where 3']),
    ('x,y\n1,2\n', ['x, y', 'do not include']),
    ('x,y,z,X\n1,2,3,4\n', ['line 1', 'not unique']),
    ('x,y,z\n', ['no points']),
    ('# nothing\n', ['no points']),
    ('1,2,3,4\n', ['4 columns and no header']),
    ('t,x,y,z\n0,1,2,3\n,1,2,3\n', ['line 3', 't is empty']),
    ('stroke,x,y,z\n0.5,1,2,3\n', ['line 2', 'whole number']),
])
def test_message_names_the_defect_and_the_line(tmp_path, text, words):
    message = refusal(read_points, write(tmp_path / 'p.csv', text), 'mm')
    assert all(word in message for word in ['p.csv', *words]), message


def test_reads_or_rejects_other_files_of_points(tmp_path):
    cloud = read_points(write(tmp_path / 'c.ply', CLOUD_PLY), 'mm')
    np.testing.assert_allclose(cloud.positions, [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006]])
    assert 'without faces' in refusal(read_points, export(tmp_path / 'a.ply'), 'mm')
    assert 'CSV, TXT or XYZ' in refusal(read_points, export(tmp_path / 'a.stl'), 'mm')
    utf16 = read_points(write(tmp_path / 'u.csv', 'x,y,z\r\n1,2,3\r\n'.encode('utf-16')), 'mm')
    np.testing.assert_allclose(utf16.positions, [[0.001, 0.002, 0.003]])
    unmarked = 'x,y,z\n1,2,3\n'.encode('utf-16-le')
    for text in (unmarked, 'x,y,z\n1,2,3µ\n'.encode('latin-1')):
        assert 'UTF-8' in refusal(read_points, write(tmp_path / 'u.csv', text), 'mm')
    assert 'does not exist' in refusal(read_points, tmp_path / 'none.csv', 'mm')
    assert 'inch' in refusal(read_points, write(tmp_path / 'p.csv', 'x,y,z\n1,2,3\n'), 'inch')


def test_detects_an_ndi_file_by_its_header(tmp_path):
    ndi = write(
        tmp_path / 'n.csv', 'Tools,Port 1,Frame,Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers\n'
        '1,Port 1,7,1,OK,0,0,0,1,2,3,0.1,0\n')
    np.testing.assert_allclose(read_points(ndi, 'mm').positions, [[0.001, 0.002, 0.003]])
    assert 'mm' in refusal(read_points, ndi, 'm')


HEAD = 'name,model_x,model_y,model_z,tracker_x,tracker_y,tracker_z\n'


def test_reads_landmarks_with_two_units(tmp_path):
    marks = read_landmarks(write(tmp_path / 'l.csv', HEAD + 'head,1,2,3,0.1,0.2,0.3\n'), 'mm', 'm')
    assert marks.names == ('head',)
    np.testing.assert_allclose(marks.model, [[0.001, 0.002, 0.003]])
    np.testing.assert_allclose(marks.touched, [[0.1, 0.2, 0.3]])


@pytest.mark.parametrize('text, words', [
    (HEAD, 'no landmarks'),
    ('name,model_x,model_y,model_z,tracker_x,tracker_y\na,1,2,3,4,5\n', 'tracker_z'),
    (HEAD + 'a,1,2,3,4,5,6\nb,1,2,3,4,5,nan\n', 'line 3'),
    (HEAD + 'a,1,2,3,4,5,\n', 'line 2'),
    (HEAD + 'a,1,2,3,4,5,x\n', 'line 2'),
    (HEAD + 'a,1,2,3,4,5,6\na,1,2,3,4,5,7\n', 'not unique'),
    ('1,2,3,4,5,6,7\n', 'columns name'),
])
def test_rejects_invalid_landmarks(tmp_path, text, words):
    assert words in refusal(read_landmarks, write(tmp_path / 'l.csv', text), 'mm', 'mm')


@settings(deadline=None, max_examples=40)
@given(rows=st.lists(st.lists(st.floats(-1e4, 1e4), min_size=3, max_size=3),
                     min_size=1,
                     max_size=20),
       order=st.permutations(['x', 'y', 'z']),
       separator=st.sampled_from([',', ';', '\t', ' ']))
def test_points_survive_writing_and_reading(tmp_path_factory, rows, order, separator):
    columns = ['xyz'.index(name) for name in order]
    lines = [separator.join(order),
             *(separator.join(repr(row[i]) for i in columns) for row in rows)]
    path = write(tmp_path_factory.mktemp('points') / 'p.csv', '\n'.join(lines))
    assert read_points(path, 'm').positions.tolist() == rows
