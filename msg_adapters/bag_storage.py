# SPDX-License-Identifier: Apache-2.0
"""
Read topics and serialized messages from the storage files of a rosbag2 recording.

A recorder that was killed leaves no metadata.yaml and an mcap file without an index. Such a file is
read from its start until it ends, and a note is added.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple, TypeVar

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from msg_adapters.files import describe_error

STORAGES = ('.mcap', '.db3')
MCAP_MAGIC = b'\x89MCAP0\r\n'
T = TypeVar('T')


class Topic(NamedTuple):
    """A topic of a bag with its number of messages."""

    name: str
    msgtype: str
    messages: int


class Raw(NamedTuple):
    """A serialized message (CDR)."""

    topic: str
    msgtype: str
    data: bytes


class BagFiles:
    """The parts of a bag that can be read: a directory with metadata, or storage files in order."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Find the parts of a bag, a directory or storage file; raise `InputError` without any."""
        self.path = Path(path)
        self.notes: list[str] = []
        if not self.path.exists():
            raise InputError(f'{path} does not exist')
        if self.path.is_file():
            if self.path.suffix not in STORAGES:
                raise InputError(
                    f'{path} is not a bag; choose a rosbag2 directory, or its .mcap or .db3 file')
            self.parts = [self.path]
        elif (self.path / 'metadata.yaml').is_file():
            self.parts = [self.path]
        else:
            # the parts of a split bag are numbered without leading zeros
            self.parts = sorted((file for file in self.path.iterdir() if file.suffix in STORAGES),
                                key=lambda file: (len(file.name), file.name))
            if not self.parts:
                raise InputError(
                    f'{path} is not a bag: it has neither metadata.yaml nor a .mcap or .db3 file')
            self.notes.append(f'{path} has no metadata.yaml, probably because its recorder was '
                              'killed; its storage files were read')

    def topics(self) -> list[Topic]:
        """Return the topics with their number of messages, sorted by name."""
        counts: Counter[tuple[str, str]] = Counter()
        for part in self.parts:
            if _is_truncated(part):
                counts.update((raw.topic, raw.msgtype) for raw in self._salvaged(part))
            else:
                counts.update(_guarded(part, _indexed_counts))
        return sorted(Topic(name, msgtype, count) for (name, msgtype), count in counts.items())

    def messages(self, names: Collection[str]) -> list[Raw]:
        """Return the messages of the topics ``names`` in the order they were received."""
        found: list[Raw] = []
        for part in self.parts:
            if _is_truncated(part):
                found += [raw for raw in self._salvaged(part) if raw.topic in names]
            else:
                found += _guarded(part, lambda file: _indexed(file, names))
        return found

    def _salvaged(self, part: Path) -> list[Raw]:
        """Return the messages that can be read from a truncated mcap file, and add a note."""
        found = _streamed(part)
        if not found:
            raise InputError(
                f'{part} has no readable messages: its recorder was killed or the file is '
                'truncated')
        note = (
            f'{part} has no index, probably because its recorder was killed or the file is '
            f'truncated; {format_count(len(found), "message")} could be read')
        if note not in self.notes:
            self.notes.append(note)
        return found


def _guarded(part: Path, read: Callable[[Path], T]) -> T:
    """Return ``read(part)``; raise `InputError` for any error of the libraries."""
    try:
        return read(part)
    except Exception as error:  # damaged bytes can cause any exception, even OverflowError
        hint = '; pass its storage file instead to read what is left' if part.is_dir() else ''
        raise InputError(
            f'{part} is damaged or truncated ({describe_error(error)}){hint}') from None


def _indexed_counts(part: Path) -> dict[tuple[str, str], int]:
    """Return (topic, type) -> number of messages of a complete bag or storage file."""
    with Reader(part) as reader:
        return {(c.topic, c.msgtype): c.msgcount for c in reader.connections}


def _indexed(part: Path, names: Collection[str]) -> list[Raw]:
    """Return the messages of a complete bag or storage file."""
    with Reader(part) as reader:
        wanted = [c for c in reader.connections if c.topic in names]
        # without connections, rosbags returns all messages
        return [Raw(c.topic, c.msgtype, data)
                for c, _, data in reader.messages(wanted)] if wanted else []


def _is_truncated(part: Path) -> bool:
    """Return whether an mcap file has the magic number at its start but not at its end."""
    if part.suffix != '.mcap':
        return False
    with part.open('rb') as file:
        begins = file.read(len(MCAP_MAGIC)) == MCAP_MAGIC
        file.seek(max(0, part.stat().st_size - len(MCAP_MAGIC)))
        return begins and file.read() != MCAP_MAGIC


def _streamed(part: Path) -> list[Raw]:
    """Return the messages of an mcap file from its start until reading fails."""
    found: list[Raw] = []
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    with part.open('rb') as file:
        try:
            size = part.stat().st_size
            for record in StreamReader(file, validate_crcs=True, record_size_limit=size).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    channels[record.id] = record.topic, schemas[record.schema_id]
                elif isinstance(record, Message):
                    found.append(Raw(*channels[record.channel_id], record.data))
        except Exception:  # a truncated file can cause any exception
            return found
    return found
