# SPDX-License-Identifier: Apache-2.0
"""
Serialize a MarkerArray directly from arrays, and read it into arrays.

rclpy needs a Python object for each corner of a triangle. While it converts those of a bone, it
holds the GIL, which delays points and the live pose. Publishers also accept serialized messages,
and subscriptions return them.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import (
    Array,
    quaternion_from_rotation,
    rotation_from_quaternion,
)


class Shape(IntEnum):
    """The types of visualization_msgs/Marker that are used."""

    ARROW = 0
    CYLINDER = 3
    LINE_LIST = 5
    SPHERE_LIST = 7
    TEXT = 9
    TRIANGLE_LIST = 11


ADD, DELETE, DELETE_ALL = 0, 2, 3       # the actions of visualization_msgs/Marker


@dataclass(frozen=True, eq=False)
class Marker:
    """
    A visualization_msgs/Marker; without a shape it deletes the marker with this namespace and id.

    ``action`` is `DELETE_ALL` to delete all markers of the topic.

    ns, id : namespace and number
    scale : m, x y z
    pose : (4, 4) float, m, in the frame of the array
    points : (n, 3) float, m, in the frame of ``pose``
    colours : (3,) or (4,) float for all points, or (n, 4) for each; red green blue alpha in [0, 1]
    text : str, of a label
    """

    ns: str
    id: int
    shape: Shape | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    pose: Array | None = None
    points: Array | None = None
    colours: Array | None = None
    text: str = ''
    action: int | None = None


def to_bytes(markers: Sequence[Marker], frame_id: str) -> bytes:
    """
    Return markers in ``frame_id`` as a serialized visualization_msgs/MarkerArray.

    They have a zero stamp and are locked to their frame: viewers use the latest transform.
    """
    cdr = _Cdr()
    cdr.pack('I', len(markers))
    for marker in markers:
        _write(cdr, marker, frame_id)
    return cdr.joined()


def _write(cdr: _Cdr, marker: Marker, frame_id: str) -> None:
    """Write the fields of visualization_msgs/Marker of Jazzy in order."""
    action = ADD if marker.shape is not None else DELETE
    pose = np.eye(4) if marker.pose is None else marker.pose
    colours = np.ones(4) if marker.colours is None else marker.colours
    one = np.append(colours, 1.0)[:4] if colours.ndim == 1 else np.ones(4)
    each = np.zeros((0, 4)) if colours.ndim == 1 else colours
    cdr.pack('iI', 0, 0)                        # stamp of the header
    cdr.text(frame_id)
    cdr.text(marker.ns)
    cdr.pack('iii', marker.id, marker.shape or 0,
             action if marker.action is None else marker.action)
    cdr.pack('3d4d', *pose[:3, 3], *quaternion_from_rotation(pose[:3, :3]))
    cdr.pack('3d', *marker.scale)
    cdr.pack('4f', *one)
    cdr.pack('iI?', 0, 0, True)                 # lifetime, frame_locked
    cdr.array(np.zeros((0, 3)) if marker.points is None else marker.points, '<f8')
    cdr.array(each, '<f4')
    cdr.text('')                                # texture: resource, image, coordinates
    cdr.pack('iI', 0, 0)
    cdr.text('')
    cdr.text('')
    cdr.pack('II', 0, 0)
    cdr.text(marker.text)
    cdr.text('')                                # mesh: resource, file, materials
    cdr.text('')
    cdr.pack('I?', 0, False)


def from_bytes(message: bytes) -> list[Marker]:
    """
    Return the markers of a serialized visualization_msgs/MarkerArray, without the deleted ones.

    Raises
    ------
    InputError
        If it is not one.

    """
    try:
        reader = _Reader(message)
        found = [_read(reader) for _ in range(reader.unpack('I')[0])]
    except (struct.error, ValueError, UnicodeDecodeError) as error:
        raise InputError(f'a message is not a MarkerArray: {error}') from None
    return [marker for marker in found if marker.action == ADD]


def _read(cdr: _Reader) -> Marker:
    """Read the fields that `_write` writes; a shape that is not in `Shape` becomes None."""
    cdr.unpack('iI')
    cdr.text()
    ns = cdr.text()
    number, kind, action = cdr.unpack('iii')
    x, y, z, *quaternion = cdr.unpack('3d4d')
    scale, one = cdr.unpack('3d'), np.array(cdr.unpack('4f'))
    cdr.unpack('iI?')
    points, each = cdr.array('<f8', 3), cdr.array('<f4', 4)
    cdr.text()
    cdr.unpack('iI')
    cdr.text()
    cdr.text()
    cdr.unpack('I')
    cdr.array('<f4', 2)
    text = cdr.text()
    cdr.text()
    cdr.text()
    cdr.unpack('I')
    cdr.unpack('?')
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_from_quaternion(quaternion), (x, y, z)
    return Marker(ns, number, Shape(kind) if kind in list(Shape) else None, scale, pose, points,
                  each if len(each) else one, text, action)


class _Reader:
    """Plain CDR, little endian, as `_Cdr`."""

    def __init__(self, message: bytes) -> None:
        self._data, self._at = memoryview(message)[4:], 0

    def unpack(self, kinds: str) -> tuple[Any, ...]:
        """Read numbers; ``kinds`` is a struct format with sizes that do not increase."""
        self._align(struct.calcsize(kinds.lstrip('0123456789')[0]))
        values = struct.unpack_from('<' + kinds, self._data, self._at)
        self._at += struct.calcsize('<' + kinds)
        return values

    def text(self) -> str:
        size, = self.unpack('I')
        encoded = bytes(self._data[self._at:self._at + size])
        self._at += size
        return encoded.rstrip(b'\x00').decode()

    def array(self, kind: str, columns: int) -> Array:
        """Read a sequence of structures of ``columns`` numbers of one type, (n, columns)."""
        rows, = self.unpack('I')
        if not rows:
            return np.zeros((0, columns))
        self._align(np.dtype(kind).itemsize)
        found = np.frombuffer(self._data, kind, rows * columns, self._at)
        self._at += found.nbytes
        return found.reshape(rows, columns).astype(np.float64)

    def _align(self, size: int) -> None:
        self._at += -self._at % size


class _Cdr:
    """Plain CDR, little endian (OMG DDSI-RTPS 2.3, 10.5): values are aligned to their size."""

    def __init__(self) -> None:
        self._parts = [b'\x00\x01\x00\x00']     # encapsulation header, not part of the alignment
        self._size = 0

    def joined(self) -> bytes:
        return b''.join(self._parts)

    def pack(self, kinds: str, *values: float) -> None:
        """Write numbers; ``kinds`` is a struct format with sizes that do not increase."""
        self._align(struct.calcsize(kinds.lstrip('0123456789')[0]))
        self._add(struct.pack('<' + kinds, *values))

    def text(self, text: str) -> None:
        """Write a zero-terminated string."""
        encoded = text.encode() + b'\x00'
        self.pack('I', len(encoded))
        self._add(encoded)

    def array(self, rows: Array, kind: str) -> None:
        """Write a sequence of structures of numbers of one type."""
        self.pack('I', len(rows))
        if len(rows):
            self._align(np.dtype(kind).itemsize)
            self._add(np.ascontiguousarray(rows, dtype=kind).tobytes())

    def _align(self, size: int) -> None:
        self._add(bytes(-self._size % size))

    def _add(self, part: bytes) -> None:
        self._parts.append(part)
        self._size += len(part)
