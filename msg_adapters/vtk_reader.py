# SPDX-License-Identifier: Apache-2.0
"""
Read a surface with VTK and store it as arrays: ``python -m msg_adapters.vtk_reader FILE OUT.npz``.

It is a process of its own, see `vtk_mesh`. It prints why a file cannot be read, and returns 2.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np


def main(file: str, out: str) -> int:
    """Store vertices (n, 3), faces (m, 3) and the axes that the file states, empty for none."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkCommand, vtkObject
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    vtkObject.GlobalWarningDisplayOff()
    reader = (vtkXMLPolyDataReader if file.lower().endswith('.vtp') else vtkPolyDataReader)()
    errors: list[str] = []
    reader.AddObserver(vtkCommand.ErrorEvent, lambda *_: errors.append('error'))
    reader.SetFileName(file)
    reader.Update()
    if errors:
        print('it is damaged, truncated, or no surface of VTK (PolyData)')
        return 2
    polygons = reader.GetOutput()
    triangles = vtkTriangleFilter()
    triangles.SetInputData(polygons)
    triangles.PassLinesOff()
    triangles.PassVertsOff()
    triangles.Update()
    mesh = triangles.GetOutput()
    if not mesh.GetNumberOfPoints() or not mesh.GetNumberOfPolys():
        print('it has no polygons')
        return 2
    np.savez(Path(out), vertices=vtk_to_numpy(mesh.GetPoints().GetData()).astype(np.float64),
             faces=vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3),
             axes=np.array(_axes(polygons)))
    return 0


def _axes(polygons: Any) -> str:
    """Return lps or ras as Slicer states it in a file, or an empty text."""
    data = polygons.GetFieldData().GetAbstractArray('SPACE')
    stated = data.GetVariantValue(0).ToString().lower() if data and data.GetNumberOfValues() else ''
    return next((axes for axes in ('lps', 'ras') if axes in stated), '')


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
