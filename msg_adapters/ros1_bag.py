# SPDX-License-Identifier: Apache-2.0
"""
Read a ROS 1 bag (format 2.0) from its start to its end, whatever is left of it.

No index is needed, so a .bag.active file of a recorder that was killed can be read. The messages
are converted to CDR by rosbags. Format: http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Collection
from pathlib import Path
from typing import BinaryIO

from rosbags.typesys import Stores, get_typestore

from gsdf_registration.common.result import InputError
from msg_adapters.stored import Contents, StoredMessage, decompressed_pieces, lz4_frame

MAGIC = b'#ROSBAG V2.0\n'
LENGTH = struct.Struct('<I')
TIME = struct.Struct('<II')     # seconds, nanoseconds
MESSAGE, CHUNK, CONNECTION = 2, 5, 7    # op
TYPES = get_typestore(Stores.ROS2_JAZZY)    # its types are those of ROS 1 but for the header's seq
DECOMPRESSORS: dict[bytes, Callable[[], Callable[[bytes], bytes]]] = {
    b'none': lambda: bytes, b'bz2': lambda: bz2.BZ2Decompressor().decompress, b'lz4': lz4_frame}
RENAMED = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}


def read_ros1_bag(path: Path, wanted: Collection[str] | None = None) -> Contents:
    """Return the messages of a bag, see `mcap_file.read_mcap`; `InputError` if it is no bag."""
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError(f'{path} is damaged or no ROS 1 bag of format 2.0')
        reader = _Reader(path, wanted)
        reader.read(file, path.stat().st_size)
    return reader.found


class _Reader:
    """Collects the messages of a file."""

    def __init__(self, path: Path, wanted: Collection[str] | None) -> None:
        self._path, self._wanted = path, wanted
        self.found = Contents()
        self._names: dict[int, tuple[str, str]] = {}    # topic and type of each connection

    def read(self, file: BinaryIO, size: int) -> None:
        """Read the records up to the end of the file."""
        place = file.tell()
        while place < size:
            try:
                fields = _fields(_block(file))
                length = LENGTH.unpack(file.read(LENGTH.size))[0]
                data = file.read(length)
                cut = len(data) < length
                self._read_record(fields, data, cut)
            except (struct.error, KeyError, ValueError, OSError, RuntimeError):
                self._cut(place, size)
                return
            if cut:
                self._cut(place, size)
                return
            place = file.tell()

    def _cut(self, place: int, size: int) -> None:
        self.found.miss(f'{self._path}: the record at byte {place} of {size} is cut or damaged, '
                        'and what follows is lost: its recorder was killed or the file was '
                        'truncated')

    def _read_record(self, fields: dict[bytes, bytes], data: bytes, cut: bool) -> None:
        op = fields[b'op'][0]
        if op == CHUNK:
            self._read_chunk(fields, data, cut)
        elif op == CONNECTION and not cut:
            number, topic = LENGTH.unpack(fields[b'conn'])[0], fields[b'topic'].decode()
            kind = _fields(data)[b'type'].decode().replace('/', '/msg/')
            self._names[number] = topic, RENAMED.get(kind, kind)
            self.found.counts.setdefault(self._names[number], 0)
        elif op == MESSAGE and not cut:
            self._add(fields, data)

    def _read_chunk(self, fields: dict[bytes, bytes], data: bytes, cut: bool) -> None:
        decompress = DECOMPRESSORS[fields[b'compression']]()
        found = bytearray()
        try:
            for piece in decompressed_pieces(iter([data]), decompress):
                found += piece
        except EOFError:
            pass
        records, place = bytes(found), 0
        while place + LENGTH.size <= len(records):
            begin = place + LENGTH.size
            end = begin + LENGTH.unpack_from(records, place)[0]
            if end + LENGTH.size > len(records):
                break
            after = end + LENGTH.size + LENGTH.unpack_from(records, end)[0]
            if after > len(records):
                break
            self._read_record(_fields(records[begin:end]), records[end + LENGTH.size:after], False)
            place = after

    def _add(self, fields: dict[bytes, bytes], data: bytes) -> None:
        name = self._names[LENGTH.unpack(fields[b'conn'])[0]]
        self.found.counts[name] += 1
        if self._wanted is not None and name[1] not in self._wanted:
            return
        try:
            cdr = bytes(TYPES.ros1_to_cdr(data, name[1]))
        # noqa: BLE001 - an unknown type or damaged bytes can cause any exception
        except Exception:
            cdr = b''       # cannot be decoded: reported where the message is used
        sec, nanosec = TIME.unpack(fields[b'time'])
        self.found.messages.append(StoredMessage(sec * 10**9 + nanosec, *name, cdr))


def _block(file: BinaryIO) -> bytes:
    """Return the next bytes that follow their length."""
    return file.read(LENGTH.unpack(file.read(LENGTH.size))[0])


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a header, name=value each."""
    fields, place = {}, 0
    while place < len(header):
        begin = place + LENGTH.size
        place = begin + LENGTH.unpack_from(header, place)[0]
        name, _, value = header[begin:place].partition(b'=')
        fields[name] = value
    return fields
