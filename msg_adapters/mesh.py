# SPDX-License-Identifier: Apache-2.0
"""
Surfaces from STL, PLY, OBJ and OFF files through trimesh, as they stand in the file.

trimesh reads some files that were cut short as if they were whole; so what the header, or the text,
promises is counted against what came out.  Repairing is left to the bone.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters.files import words_of


class Surface(NamedTuple):
    """
    Content of a file in its own unit.

    Vertices (n, 3), faces (m, 3) or None, normals (n, 3) or None.
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
        If the file is damaged, cut short, or has no vertices.

    """
    kind = path.suffix.lower()
    if kind == '.stl':
        _check_stl_length(path)
    bodies = _bodies(path)
    if not bodies:
        raise InputError(f'{path} has no vertices: it is empty or damaged')
    vertices = np.concatenate([body.vertices for body in bodies]).astype(np.float64)
    starts = np.concatenate([[0], np.cumsum([len(body.vertices) for body in bodies])])
    parts = [
        body.faces + start for body, start in zip(bodies, starts)
        if isinstance(body, trimesh.Trimesh)
    ]
    faces = np.concatenate(parts).astype(np.int64) if parts else np.zeros((0, 3), np.int64)
    _CHECKS[kind](path, bodies, len(faces))
    if not len(faces):
        return Surface(vertices, None, _normals(bodies[0]))
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        raise InputError(f'{path} is damaged: its faces name vertices that it does not have')
    return Surface(vertices, faces.astype(np.int32), None)


def _bodies(path: Path) -> list[Any]:
    """Return the bodies of a file as trimesh reads them, in one frame, untouched."""
    try:
        with warnings.catch_warnings():
            # older numpy only warns, and goes on with half a line
            warnings.filterwarnings('error', message='string or file could not be read')
            scene = trimesh.load_scene(str(path), process=False, skip_materials=True)
    except Exception as error:  # a damaged file may lead the parsers to any exception
        polygons = ', or has polygons that are not triangles' if path.suffix.lower(
        ) == '.ply' else ''
        raise InputError(
            f'{path} is damaged, cut short{polygons}, or no {path.suffix[1:].upper()} file '
            f'({words_of(error)})') from None
    return [body for body in scene.dump()
            if isinstance(body, (trimesh.Trimesh, trimesh.PointCloud)) and len(body.vertices)]


def _normals(cloud: Any) -> Array | None:
    """Return the normals of a PLY point cloud, which trimesh keeps only in the raw data."""
    vertex = cloud.metadata.get('_ply_raw', {}).get('vertex', {})
    if not {'nx', 'ny', 'nz'} <= set(vertex.get('properties', ())):
        return None
    return np.column_stack([vertex['data'][name] for name in ('nx', 'ny', 'nz')]).astype(np.float64)


def _check_stl_length(path: Path) -> None:
    """
    Raise `InputError` if an STL file is not as long as it says.

    Trimesh would take it for an empty one.
    """
    content = path.read_bytes()
    if _is_ascii_stl(content):
        if _count(rb'^\s*solid\b', content) > _count(rb'^\s*endsolid\b', content):
            raise InputError(f'{path} is cut short: it ends before "endsolid"')
        return
    if len(content) < 84:
        raise InputError(f'{path} is cut short: {len(content)} bytes are too few for an STL file')
    count = int.from_bytes(content[80:84], 'little')
    if len(content) != 84 + 50 * count:
        raise InputError(f'{path} is cut short or damaged: its header announces '
                         f'{counted(count, "triangle")} '
                         f'({84 + 50 * count} bytes), the file has {len(content)} bytes')


def _check_stl(path: Path, _: list[Any], faces: int) -> None:
    """Compare the facets of a text with the triangles read."""
    content = path.read_bytes()
    if _is_ascii_stl(content):
        _check_count(path, 'facets', _count(rb'^\s*facet\b', content), faces)


def _check_ply(path: Path, bodies: list[Any], faces: int) -> None:
    """Compare the header's counts with the records read: by property, or one array."""
    for name, element in bodies[0].metadata['_ply_raw'].items():
        data = element.get('data')
        if isinstance(data, dict):
            data = next(iter(data.values()), None)
        rows = 0 if data is None else len(data)
        # a last face cut to fewer than three corners is a record, but no triangle
        _check_count(path, f'{name} records', element['length'],
                     min(rows, faces) if name == 'face' else rows)


def _check_off(path: Path, _: list[Any], __: int) -> None:
    """Compare the counts of the header with the complete lines that follow."""
    text = re.sub(r'#.*', '', path.read_text('utf-8', 'replace')).partition('OFF')[2]
    lines = [line.split() for line in text.splitlines() if line.strip()]
    vertices, faces = int(lines[0][0]), int(lines[0][1])
    complete = sum(len(line) > int(line[0]) for line in lines[1 + vertices:1 + vertices + faces])
    _check_count(path, 'faces', faces, complete)


def _check_obj(path: Path, _: list[Any], __: int) -> None:
    """Look for a vertex or face with fewer than three numbers, as a file cut short ends."""
    text = path.read_text('utf-8', 'replace')
    short = re.search(r'^[ \t]*[vf]([ \t]+\S+){0,2}[ \t]*$', text, re.MULTILINE)
    if short:
        raise InputError(
            f'{path} is cut short or damaged: the line {short.group().strip()!r} is incomplete')


_CHECKS = {'.stl': _check_stl, '.ply': _check_ply, '.off': _check_off, '.obj': _check_obj}


def _check_count(path: Path, what: str, announced: int, read: int) -> None:
    """Raise `InputError` if less was read than announced."""
    if read < announced:
        raise InputError(
            f'{path} is cut short or damaged: it announces {announced} {what} and has {read}')


def _is_ascii_stl(content: bytes) -> bool:
    """Tell text from binary; a binary header may begin with "solid" too."""
    return content[:5].lower() == b'solid' and b'facet' in content[:1000].lower()


def _count(pattern: bytes, content: bytes) -> int:
    """Return how many lines begin with a word, whatever its case."""
    return len(re.findall(pattern, content, re.MULTILINE | re.IGNORECASE))
