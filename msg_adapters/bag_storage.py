# SPDX-License-Identifier: Apache-2.0
"""
The files of a rosbag2 recording: which there are, their topics, their messages still serialized.

A recorder that was killed leaves no metadata.yaml and an mcap without its index; such files are
read from the start as far as they go, and a note says so.
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

from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import InputError
from msg_adapters.files import words_of

STORAGES = ('.mcap', '.db3')
MCAP_MAGIC = b'\x89MCAP0\r\n'
T = TypeVar('T')


class Topic(NamedTuple):
    """One topic of a bag, and how many messages it has."""

    name: str
    msgtype: str
    messages: int


class Raw(NamedTuple):
    """One message as it lies in a bag (CDR)."""

    topic: str
    msgtype: str
    data: bytes


class BagFiles:
    """The readable parts of a bag: a directory with its metadata, or storage files in order."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Find the parts of a bag (directory or storage file); `InputError` if there are none."""
        self.path = Path(path)
        self.notes: list[str] = []
        if not self.path.exists():
            raise InputError(f'{path} does not exist')
        if self.path.is_file():
            if self.path.suffix not in STORAGES:
                raise InputError(
                    f'{path} is no bag: give a rosbag2 directory, or its .mcap or .db3 file')
            self.parts = [self.path]
        elif (self.path / 'metadata.yaml').is_file():
            self.parts = [self.path]
        else:
            # the parts of a split bag are numbered without leading zeros
            self.parts = sorted((file for file in self.path.iterdir() if file.suffix in STORAGES),
                                key=lambda file: (len(file.name), file.name))
            if not self.parts:
                raise InputError(
                    f'{path} is no bag: it has neither metadata.yaml nor a .mcap or .db3 file')
            self.notes.append(f'{path} has no metadata.yaml, as if its recorder was killed: '
                              'its storage files were read')

    def topics(self) -> list[Topic]:
        """Return the topics with their number of messages, sorted by name."""
        counts: Counter[tuple[str, str]] = Counter()
        for part in self.parts:
            if _lacks_end(part):
                counts.update((raw.topic, raw.msgtype) for raw in self._salvaged(part))
            else:
                counts.update(_guarded(part, _indexed_counts))
        return sorted(Topic(name, msgtype, count) for (name, msgtype), count in counts.items())

    def messages(self, names: Collection[str]) -> list[Raw]:
        """Return the messages of the topics ``names`` in the order they were received."""
        found: list[Raw] = []
        for part in self.parts:
            if _lacks_end(part):
                found += [raw for raw in self._salvaged(part) if raw.topic in names]
            else:
                found += _guarded(part, lambda file: _indexed(file, names))
        return found

    def _salvaged(self, part: Path) -> list[Raw]:
        """Return what can be read of an mcap that lacks its end, and note it."""
        found = _streamed(part)
        if not found:
            raise InputError(
                f'{part} holds nothing readable: its recorder was killed or the copy cut short')
        note = (
            f'{part} ends without its index, as if its recorder was killed or the copy was cut '
            f'short: {counted(len(found), "message")} read up to there')
        if note not in self.notes:
            self.notes.append(note)
        return found


def _guarded(part: Path, read: Callable[[Path], T]) -> T:
    """Return ``read(part)``, any error of the libraries turned into one sentence."""
    try:
        return read(part)
    except Exception as error:  # damaged bytes lead the libraries to any, OverflowError included
        hint = ': give its storage file alone to read what is left' if part.is_dir() else ''
        raise InputError(f'{part} is damaged or cut short ({words_of(error)}){hint}') from None


def _indexed_counts(part: Path) -> dict[tuple[str, str], int]:
    """Return (topic, type) -> number of messages of a whole bag or storage file."""
    with Reader(part) as reader:
        return {(c.topic, c.msgtype): c.msgcount for c in reader.connections}


def _indexed(part: Path, names: Collection[str]) -> list[Raw]:
    """Return the messages of a whole bag or storage file."""
    with Reader(part) as reader:
        wanted = [c for c in reader.connections if c.topic in names]
        # without connections rosbags would return all messages
        return [Raw(c.topic, c.msgtype, data)
                for c, _, data in reader.messages(wanted)] if wanted else []


def _lacks_end(part: Path) -> bool:
    """Tell an mcap that begins as one but does not end as one."""
    if part.suffix != '.mcap':
        return False
    with part.open('rb') as file:
        begins = file.read(len(MCAP_MAGIC)) == MCAP_MAGIC
        file.seek(max(0, part.stat().st_size - len(MCAP_MAGIC)))
        return begins and file.read() != MCAP_MAGIC


def _streamed(part: Path) -> list[Raw]:
    """Return the messages of an mcap from its start until it cannot be read further."""
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
        except Exception:  # any of many: it is how a file without an end ends
            return found
    return found
