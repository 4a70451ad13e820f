# SPDX-License-Identifier: Apache-2.0
"""Read surfaces from the files of VTK, .vtk and .vtp, with the library of the extra ct."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gsdf_registration.common.result import InputError
from msg_adapters.extras import needed
from msg_adapters.mesh import Surface

VTK_FILES = ('.vtk', '.vtp')


def load_vtk(path: Path) -> Surface:
    """
    Read the polygons of a file as triangles.

    Raises
    ------
    InputError
        If VTK is missing, or the file is damaged or has no polygons.

    """
    convert = needed('vtk.util.numpy_support', 'ct', '.vtk and .vtp files')
    polygons = _polygons(path)
    triangles = needed('vtkmodules.vtkFiltersCore', 'ct', '.vtk files').vtkTriangleFilter()
    triangles.SetInputData(polygons)
    triangles.PassLinesOff()
    triangles.PassVertsOff()
    triangles.Update()
    mesh = triangles.GetOutput()
    if not mesh.GetNumberOfPoints() or not mesh.GetNumberOfPolys():
        raise InputError(f'{path} has no polygons: it is damaged, or no surface')
    vertices = convert.vtk_to_numpy(mesh.GetPoints().GetData()).astype(np.float64)
    faces = convert.vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        raise InputError(f'{path} is damaged: its faces refer to vertices that do not exist')
    return Surface(vertices, faces.astype(np.int32), None)


def vtk_axes(path: Path) -> str | None:
    """Return the axes, lps or ras, that Slicer states in a file, None if there are none."""
    data = _polygons(path).GetFieldData().GetAbstractArray('SPACE')
    stated = data.GetVariantValue(0).ToString().lower() if data and data.GetNumberOfValues() else ''
    return next((axes for axes in ('lps', 'ras') if axes in stated), None)


def _polygons(path: Path) -> Any:
    """Return the vtkPolyData of a file; the errors of VTK become one `InputError`."""
    core = needed('vtkmodules.vtkCommonCore', 'ct', '.vtk and .vtp files')
    if path.suffix.lower() == '.vtp':
        reader = needed('vtkmodules.vtkIOXML', 'ct', '.vtp files').vtkXMLPolyDataReader()
    else:
        reader = needed('vtkmodules.vtkIOLegacy', 'ct', '.vtk files').vtkPolyDataReader()
    errors: list[str] = []
    reader.SetFileName(str(path))
    reader.AddObserver('ErrorEvent', lambda *_: errors.append('error'))
    core.vtkObject.GlobalWarningDisplayOff()
    try:
        reader.Update()
    finally:
        core.vtkObject.GlobalWarningDisplayOn()
    if errors:
        raise InputError(f'{path} is damaged, truncated, or no surface of VTK (PolyData)')
    return reader.GetOutput()
