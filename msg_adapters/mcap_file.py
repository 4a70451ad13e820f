# SPDX-License-Identifier: Apache-2.0
"""
Read an mcap file from its start to its end, whatever is left of it.

No index is needed. A file that is cut yields every whole message, those of its last chunk included.
A chunk whose checksum does not match is left out, and reported with its place. Format:
https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from gsdf_registration.common.result import InputError
from msg_adapters.stored import Contents, StoredMessage, decompressed_pieces, lz4_frame, zstd

MAGIC = b'\x89MCAP0\r\n'
RECORD = struct.Struct('<BQ')           # opcode, length
CHUNK = struct.Struct('<QQQII')         # start, end, size, CRC, length of the compression's name
MESSAGE = struct.Struct('<HIQQ')        # channel, sequence, log time, publish time
MAX_LENGTH = 2**32      # bytes of a record or chunk; more is damage
DECOMPRESSORS = {'zstd': zstd, 'lz4': lz4_frame, '': lambda: bytes}


class _Damaged(Exception):
    """Bytes that cannot be what was written."""


def read_mcap(path: Path, wanted: Collection[str] | None = None) -> Contents:
    """
    Return the messages of an mcap file.

    Parameters
    ----------
    path : path
    wanted : collection of str, optional
        Types whose messages are returned; by default all. The others are only counted.

    Raises
    ------
    InputError
        If it is no mcap file.

    """
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError(f'{path} is damaged or no mcap file: it does not start like one')
        reader = _Reader(path, path.stat().st_size)
        reader.read(file)
    return reader.contents(wanted)


class _Reader:
    """Collects the records of a file."""

    def __init__(self, path: Path, size: int) -> None:
        self._path, self._size = path, size
        self._found = Contents()
        self._messages: list[tuple[int, int, bytes]] = []      # channel, log time, data
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def contents(self, wanted: Collection[str] | None) -> Contents:
        """Return the messages; their channels may stand behind them, in the summary."""
        found = self._found
        names = {number: (channel.topic, self._type_of(channel))
                 for number, channel in self._channels.items()}
        unknown = 0
        for channel, time, data in self._messages:
            if channel not in names:
                unknown += 1
                continue
            found.counts[names[channel]] += 1
            if wanted is None or names[channel][1] in wanted:
                found.messages.append(StoredMessage(time, *names[channel], data))
        for name in names.values():
            found.counts.setdefault(name, 0)
        found.definitions = {schema.name: schema.data.decode('utf-8', 'replace')
                             for schema in self._schemas.values()}
        if unknown:
            found.miss(f'{self._path} has {unknown} messages of topics that it does not name')
        return found

    def _type_of(self, channel: Channel) -> str:
        schema = self._schemas.get(channel.schema_id)
        return '' if schema is None else schema.name

    def read(self, file: BinaryIO) -> None:
        """Read the records up to the footer, or up to the place where the file ends."""
        while True:
            place = file.tell()
            head = file.read(RECORD.size)
            if len(head) < RECORD.size:
                self._cut(place)
                return
            opcode, length = RECORD.unpack(head)
            if not opcode or length > MAX_LENGTH:
                self._found.miss(f'{self._path} is damaged at byte {place}; what follows is lost')
                return
            cut = file.tell() + length > self._size
            try:
                if opcode == Opcode.CHUNK:
                    self._read_chunk(file.read(length), cut)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE) and not cut:
                    self._read_record(opcode, file.read(length))
                else:
                    file.seek(length, 1)
            except _Damaged as error:
                self._found.miss(f'{self._path}: the chunk at byte {place} is damaged and left '
                                 f'out: {error}')
            # noqa: BLE001 - damaged bytes can cause any exception in the library
            except Exception:
                self._found.miss(f'{self._path}: the record at byte {place} is damaged and left '
                                 'out')
            if cut:
                self._cut(place)
                return
            if opcode == Opcode.FOOTER:
                return

    def _cut(self, place: int) -> None:
        self._found.miss(f'{self._path} ends at byte {self._size}, in the record that starts at '
                         f'byte {place}: its recorder was killed or the file was truncated')

    def _read_chunk(self, data: bytes, cut: bool) -> None:
        """Read the records of a chunk; of one that is ``cut``, those that are whole."""
        if len(data) < CHUNK.size:
            return
        start, end, size, crc, named = CHUNK.unpack_from(data)
        begin = CHUNK.size + named + 8
        name = data[CHUNK.size:CHUNK.size + named].decode('ascii', 'replace')
        if name not in DECOMPRESSORS:
            raise _Damaged(f'its compression is "{name}"')
        if size > MAX_LENGTH:
            raise _Damaged(f'its size is {size} bytes')
        records = _decompressed(data[begin:], name, cut)
        if not cut and (len(records) != size or (crc and zlib.crc32(records) != crc)):
            span = f'it covers {1e-9 * (end - start):.1f} s, from {1e-9 * start:.3f} s on'
            raise _Damaged(f'its checksum does not match; {span}')
        place = 0
        while place + RECORD.size <= len(records):
            opcode, length = RECORD.unpack_from(records, place)
            place += RECORD.size
            if place + length > len(records):
                return
            self._read_record(opcode, records[place:place + length])
            place += length

    def _read_record(self, opcode: int, data: bytes) -> None:
        if opcode == Opcode.MESSAGE:
            channel, _, time, _ = MESSAGE.unpack_from(data)
            self._messages.append((channel, time, data[MESSAGE.size:]))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(data)))
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel_ = Channel.read(ReadDataStream(BytesIO(data)))
            self._channels[channel_.id] = channel_


def _decompressed(data: bytes, compression: str, cut: bool) -> bytes:
    """Return the records of a chunk; of one that is ``cut``, those before the cut."""
    records = bytearray()
    try:
        for piece in decompressed_pieces(iter([data]), DECOMPRESSORS[compression]()):
            records += piece
    # noqa: BLE001 - damaged bytes can cause any exception in the libraries
    except Exception as error:
        if not cut:
            raise _Damaged(f'it cannot be decompressed ({error})') from None
    return bytes(records)
