# SPDX-License-Identifier: Apache-2.0
"""
Save and load fields.

A file consists of the magic number, the length of the header, the header (JSON), the arrays in
little-endian order, and a CRC-32 of everything before it. Loading executes no code (no pickle).
"""

from __future__ import annotations

import json
import math
import os
import stat
import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.field.field import Field
from gsdf_registration.field.sample import FieldArrays

MAGIC = b'GSDF\r\n\x1a\n'     # as in PNG: detects a file that was converted as text
VERSION = 1
# bytes, of the first array: aligned arrays need no further specialization of the kernels
ALIGNMENT = 64
_DTYPES = {'block_of': '<i4', 'nodes': '<f4', 'surface_points': '<f4', 'surface_normals': '<f4',
           'vertices': '<f4', 'faces': '<i4'}


def save_field(field: Field, path: str | os.PathLike[str]) -> None:
    """
    Write a field to a file atomically.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    path = Path(path)
    arrays = {name: np.ascontiguousarray(array, dtype=_DTYPES[name])
              for name, array in _arrays(field).items()}
    header = json.dumps({
        'version': VERSION, 'voxel_size': field.voxel_size, 'origin': field.arrays.origin.tolist(),
        'first_coarse': field.arrays.first_coarse, 'bounds': field.bounds.tolist(),
        'bone_sha256': field.bone_sha256, 'notes': list(field.notes),
        'shapes': {name: array.shape for name, array in arrays.items()}}).encode()
    header += b' ' * (-(len(MAGIC) + 4 + len(header)) % ALIGNMENT)
    parts = [
        MAGIC,
        struct.pack('<I', len(header)), header, *(array.tobytes() for array in arrays.values())
    ]
    checksum = 0
    for part in parts:
        checksum = zlib.crc32(part, checksum)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix='.tmp')
        try:
            with os.fdopen(handle, 'wb') as file:
                file.writelines([*parts, struct.pack('<I', checksum)])
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        raise InputError(f'{path}: cannot be written ({error.strerror})') from error


def load_field(path: str | os.PathLike[str]) -> Field:
    """
    Read a field from a file.

    Raises
    ------
    InputError
        If the file cannot be read, is not a field, has another format version, or is damaged.

    """
    try:
        found = os.stat(path)
        if not stat.S_ISREG(found.st_mode):     # opening a FIFO would wait for ever
            raise InputError(f'{path}: cannot be read (it is not a regular file)')
        data = bytearray(found.st_size)
        with open(path, 'rb') as file:
            file.readinto(data)
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    start = len(MAGIC) + 4
    if data[:len(MAGIC)] != MAGIC:
        raise InputError(f'{path}: is not a field file; build one with `gsdf build`')
    damaged = InputError(
        f'{path}: the field file is damaged or truncated; build it again with `gsdf build`')
    try:
        end = start + struct.unpack('<I', data[len(MAGIC):start])[0]
        header = json.loads(data[start:end])
        version = header['version']
    except (struct.error, ValueError, KeyError, TypeError) as error:
        raise damaged from error
    if version != VERSION:
        raise InputError(
            f'{path}: has format version {version}, but only version {VERSION} is supported; '
            'build it again with `gsdf build`')
    if struct.pack('<I', zlib.crc32(memoryview(data)[:-4])) != data[-4:]:
        raise damaged
    try:
        return _field(header, data, end)
    except (KeyError, TypeError, ValueError) as error:
        raise damaged from error


def _arrays(field: Field) -> dict[str, np.ndarray]:
    """Return the arrays of a field by name, see `_DTYPES`."""
    a = field.arrays
    return {
        'block_of': a.block_of, 'nodes': a.nodes, 'surface_points': field.surface_points,
        'surface_normals': field.surface_normals, 'vertices': field.vertices, 'faces': field.faces
    }


def _field(header: dict[str, Any], data: bytearray, offset: int) -> Field:
    """Return the field of a valid ``header``; its arrays are views of ``data``."""
    arrays = {}
    for name, shape in header['shapes'].items():
        arrays[name] = np.frombuffer(data, _DTYPES[name], math.prod(shape), offset).reshape(shape)
        offset += arrays[name].nbytes
    kernels = FieldArrays(np.array(header['origin']), header['voxel_size'], arrays.pop('block_of'),
                          arrays.pop('nodes'), header['first_coarse'])
    return Field(kernels,
                 header['bone_sha256'],
                 np.array(header['bounds']),
                 notes=tuple(header['notes']),
                 **arrays)
