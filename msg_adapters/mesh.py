# SPDX-License-Identifier: Apache-2.0
"""
Read surfaces from STL, PLY, OBJ, OFF, 3MF and GLB files with trimesh, without repair.

trimesh accepts some truncated files. Therefore the number of elements that the header or the text
announces is compared with the number that was read.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters.extras import needed
from msg_adapters.files import describe_error


class Surface(NamedTuple):
    """
    The content of a file in the unit of the file.

    vertices : (n, 3) float64
    faces : (m, 3) int32, or None
    normals : (n, 3) float64, or None
    """

    vertices: Array
    faces: NDArray[np.int32] | None
    normals: Array | None


def load_surface(path: Path) -> Surface:
    """
    Read all bodies of a mesh or point-cloud file as one surface.

    Raises
    ------
    InputError
        If the file is damaged or truncated, or has no vertices.

    """
    kind = path.suffix.lower()
    if kind == '.3mf':
        for module in ('lxml', 'networkx'):
            needed(module, 'ct', '.3mf files')
    if kind == '.stl':
        _check_stl_length(path)
    bodies = _bodies(path)
    if not bodies:
        raise InputError(f'{path} has no vertices: it is empty or damaged')
    vertices = np.concatenate([body.vertices for body in bodies]).astype(np.float64)
    starts = np.concatenate([[0], np.cumsum([len(body.vertices) for body in bodies])])
    parts = [body.faces + start for body, start in zip(bodies, starts)
             if hasattr(body, 'faces')]
    faces = np.concatenate(parts).astype(np.int64) if parts else np.zeros((0, 3), np.int64)
    if kind in _CHECKS:
        _CHECKS[kind](path, bodies, len(faces))
    if not len(faces):
        return Surface(vertices, None, _normals(bodies[0]))
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        raise InputError(f'{path} is damaged: its faces refer to vertices that do not exist')
    return Surface(vertices, faces.astype(np.int32), None)


def _bodies(path: Path) -> list[Any]:
    """Return the bodies of a file as trimesh reads them, in one frame, without processing."""
    import trimesh  # takes 0.4 s, for which commands without a mesh need not wait
    try:
        with warnings.catch_warnings():
            # older NumPy versions only warn about an incomplete line
            warnings.filterwarnings('error', message='string or file could not be read')
            scene = trimesh.load_scene(str(path), process=False, skip_materials=True)
    except Exception as error:  # a damaged file can cause any exception in the parsers
        polygons = (', or has polygons that are not triangles'
                    if path.suffix.lower() == '.ply' else '')
        raise InputError(
            f'{path} is damaged, truncated{polygons}, or not an {path.suffix[1:].upper()} file '
            f'({describe_error(error)})') from None
    return [body for body in scene.dump()
            if isinstance(body, (trimesh.Trimesh, trimesh.PointCloud)) and len(body.vertices)]


def _normals(cloud: Any) -> Array | None:
    """Return the normals of a PLY point cloud, which trimesh provides only in the raw data."""
    vertex = cloud.metadata.get('_ply_raw', {}).get('vertex', {})
    if not {'nx', 'ny', 'nz'} <= set(vertex.get('properties', ())):
        return None
    return np.column_stack([vertex['data'][name] for name in ('nx', 'ny', 'nz')]).astype(np.float64)


def _check_stl_length(path: Path) -> None:
    """
    Raise `InputError` if an STL file does not have the announced length.

    trimesh would read it as an empty file.
    """
    content = path.read_bytes()
    if _is_ascii_stl(content):
        if _count(rb'^\s*solid\b', content) > _count(rb'^\s*endsolid\b', content):
            raise InputError(f'{path} is truncated: it ends before "endsolid"')
        return
    if len(content) < 84:
        raise InputError(f'{path} is truncated: {len(content)} bytes are too few for an STL file')
    count = int.from_bytes(content[80:84], 'little')
    if len(content) != 84 + 50 * count:
        raise InputError(f'{path} is truncated or damaged: its header announces '
                         f'{format_count(count, "triangle")} '
                         f'({84 + 50 * count} bytes), the file has {len(content)} bytes')


def _check_stl(path: Path, _: list[Any], faces: int) -> None:
    """Compare the number of facets of a text file with the number of triangles read."""
    content = path.read_bytes()
    if _is_ascii_stl(content):
        _check_count(path, 'facets', _count(rb'^\s*facet\b', content), faces)


def _check_ply(path: Path, bodies: list[Any], faces: int) -> None:
    """Compare the numbers in the header with the number of records read."""
    for name, element in bodies[0].metadata['_ply_raw'].items():
        data = element.get('data')
        if isinstance(data, dict):
            data = next(iter(data.values()), None)
        rows = 0 if data is None else len(data)
        # a truncated last face is a record, but not a triangle
        _check_count(path, f'{name} records', element['length'],
                     min(rows, faces) if name == 'face' else rows)


def _check_off(path: Path, _: list[Any], __: int) -> None:
    """Compare the numbers in the header with the number of complete lines."""
    text = re.sub(r'#.*', '', path.read_text('utf-8', 'replace')).partition('OFF')[2]
    lines = [line.split() for line in text.splitlines() if line.strip()]
    vertices, faces = int(lines[0][0]), int(lines[0][1])
    complete = sum(len(line) > int(line[0]) for line in lines[1 + vertices:1 + vertices + faces])
    _check_count(path, 'faces', faces, complete)


def _check_obj(path: Path, _: list[Any], __: int) -> None:
    """Search for a vertex or face with fewer than three numbers, as in a truncated file."""
    text = path.read_text('utf-8', 'replace')
    short = re.search(r'^[ \t]*[vf]([ \t]+\S+){0,2}[ \t]*$', text, re.MULTILINE)
    if short:
        raise InputError(
            f'{path} is truncated or damaged: the line {short.group().strip()!r} is incomplete')


_CHECKS = {'.stl': _check_stl, '.ply': _check_ply, '.off': _check_off, '.obj': _check_obj}


def _check_count(path: Path, what: str, announced: int, read: int) -> None:
    """Raise `InputError` if fewer elements were read than announced."""
    if read < announced:
        raise InputError(
            f'{path} is truncated or damaged: it announces {announced} {what} and has {read}')


def _is_ascii_stl(content: bytes) -> bool:
    """Return whether an STL file is text; a binary header may also begin with "solid"."""
    return content[:5].lower() == b'solid' and b'facet' in content[:1000].lower()


def _count(pattern: bytes, content: bytes) -> int:
    """Return the number of matches, ignoring case."""
    return len(re.findall(pattern, content, re.MULTILINE | re.IGNORECASE))
