# SPDX-License-Identifier: Apache-2.0
"""Test reading of surfaces from the files of VTK."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

from gsdf_registration.common.result import InputError
from msg_adapters.points import read_model
from msg_adapters.slicer import model_axes

BALL = trimesh.creation.icosphere(2, 0.04)
V, F = BALL.vertices, BALL.faces


def poly_data(space: str = '') -> vtk.vtkPolyData:
    """Return a ball, with a line that is no part of the surface."""
    points, cells = vtk.vtkPoints(), vtk.vtkCellArray()
    points.SetData(numpy_to_vtk(1e3 * V, deep=True))
    cells.ImportLegacyFormat(numpy_to_vtkIdTypeArray(
        np.insert(F, 0, 3, axis=1).astype(np.int64).ravel(), deep=True))
    data = vtk.vtkPolyData()
    data.SetPoints(points)
    data.SetPolys(cells)
    lines = vtk.vtkCellArray()
    lines.InsertNextCell(2, [0, 1])
    data.SetLines(lines)
    if space:
        array = vtk.vtkStringArray()
        array.SetName('SPACE')
        array.InsertNextValue(space)
        data.GetFieldData().AddArray(array)
    return data


def write(path: Path, data: vtk.vtkPolyData, header: str = '') -> Path:
    writer = vtk.vtkXMLPolyDataWriter() if path.suffix == '.vtp' else vtk.vtkPolyDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    if header:
        writer.SetHeader(header)
    writer.Write()
    return path


@pytest.mark.parametrize('name', ['a.vtk', 'a.vtp'])
def test_reads_the_polygons(tmp_path: Path, name: str) -> None:
    vertices, faces, normals = read_model(write(tmp_path / name, poly_data()), 'mm')
    np.testing.assert_allclose(vertices, V, atol=1e-7)
    np.testing.assert_array_equal(faces, F)
    assert normals is None


def test_finds_the_axes_that_slicer_states(tmp_path: Path) -> None:
    legacy = write(tmp_path / 'a.vtk', poly_data(), '3D Slicer output. SPACE=RAS')
    assert model_axes(legacy) == 'ras'
    assert model_axes(write(tmp_path / 'a.vtp', poly_data('RAS'))) == 'ras'
    assert model_axes(write(tmp_path / 'b.vtp', poly_data('SPACE=LPS'))) == 'lps'
    assert model_axes(write(tmp_path / 'c.vtp', poly_data())) is None


@pytest.mark.parametrize('name', ['a.vtk', 'a.vtp'])
def test_a_damaged_file_is_named(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
                                 ) -> None:
    path = write(tmp_path / name, poly_data())
    content = path.read_bytes()
    for damaged in (content[:len(content) // 2], b'not a file of VTK',
                    b'# vtk DataFile Version 5.1\n\nASCII\nDATASET POLYDATA\nPOINTS 9 float\n1'):
        path.write_bytes(damaged)
        with pytest.raises(InputError) as caught:
            read_model(path, 'mm')
        assert name in caught.value.message and '\n' not in caught.value.message
    assert capfd.readouterr().err == ''


def test_a_file_without_polygons_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='has no polygons'):
        read_model(write(tmp_path / 'a.vtp', vtk.vtkPolyData()), 'mm')
