# SPDX-License-Identifier: Apache-2.0
"""
Find the storage files of a recording and read their messages in the order received.

The files are read without index and metadata: a recorder that was killed leaves neither. What
cannot be read is reported with its place, see `BagFiles.notes`.
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from msg_adapters.files import parse_yaml
from msg_adapters.mcap_file import read_mcap
from msg_adapters.ros1_bag import read_ros1_bag
from msg_adapters.sqlite_file import read_sqlite
from msg_adapters.stored import (
    Contents,
    StoredMessage,
    decompressed,
    decompressed_pieces,
    lz4_frame,
    zstd,
)

READERS: dict[str, Callable[[Path, Collection[str] | None], Contents]] = {
    '.mcap': read_mcap, '.db3': read_sqlite, '.bag': read_ros1_bag, '.active': read_ros1_bag}
COMPRESSED = {'.zstd': zstd, '.zst': zstd, '.lz4': lz4_frame}       # whole files
BLOCK = 1 << 20     # bytes of a compressed file that are read at once


class Topic(NamedTuple):
    """A topic of a bag with its number of messages."""

    name: str
    msgtype: str
    messages: int


class Raw(NamedTuple):
    """A serialized message (CDR), ``received`` at this time, ns."""

    topic: str
    msgtype: str
    data: bytes
    received: int


class BagFiles:
    """
    The storage files of a recording.

    Parameters
    ----------
    path : path
        A directory or a storage file.
    types : collection of str, optional
        Message types to keep; by default all. Those of the others are only counted.

    Attributes
    ----------
    path : Path
    notes : list of str
        Sentences on what is damaged or missing, after the messages have been read.
    complete : bool
        Whether nothing is missing, after the messages have been read.
    definitions : dict of str to str
        Text of the definition of each type, where the files have it.

    """

    def __init__(self, path: str | os.PathLike[str], types: Collection[str] | None = None) -> None:
        """Find the files of a bag, a directory or storage file; raise `InputError` without any."""
        self.path = Path(path)
        self.notes: list[str] = []
        self.complete = True
        self.definitions: dict[str, str] = {}
        if not self.path.exists():
            raise InputError(f'{path} does not exist')
        if self.path.is_file():
            if not is_storage(self.path):
                raise InputError(f'{path} is not a bag; choose a rosbag2 directory, its .mcap or '
                                 '.db3 file, or a .bag file of ROS 1')
            self.parts = [self.path]
        else:
            self.parts = self._parts_of_folder()
        self._types = types
        self._counts: Counter[tuple[str, str]] = Counter()
        self._messages: list[Raw] | None = None

    def topics(self) -> list[Topic]:
        """Return the topics with their number of messages, sorted by name."""
        self._read()
        return sorted(Topic(name, msgtype, count)
                      for (name, msgtype), count in self._counts.items())

    def messages(self, names: Collection[str]) -> list[Raw]:
        """
        Return the messages of the topics ``names`` in the order they were received.

        Raises
        ------
        InputError
            If no file can be read.

        """
        return [raw for raw in self._read() if raw.topic in names]

    def _read(self) -> list[Raw]:
        """Return all messages of the types; the files are read once."""
        if self._messages is not None:
            return self._messages
        found, failures = list[StoredMessage](), list[InputError]()
        for part in self.parts:
            try:
                contents = _contents(part, self._types)
            except InputError as error:
                failures.append(error)
                continue
            self._counts.update(contents.counts)
            self.definitions |= contents.definitions
            self._note(contents, part)
            found += contents.messages
        if len(failures) == len(self.parts):
            raise failures[0]
        for failure in failures:
            self._add_note(failure.message)
            self.complete = False
        found.sort(key=lambda message: message.time)    # stable; a recorder may write in blocks
        self._messages = [Raw(each.topic, each.msgtype, decompressed(each.data), each.time)
                          for each in found]
        return self._messages

    def _note(self, contents: Contents, part: Path) -> None:
        readable = format_count(sum(contents.counts.values()), 'message')
        if not contents.complete:
            self.complete = False
            if not sum(contents.counts.values()):
                raise InputError(f'{part} has no readable messages: {contents.defects[0]}')
            for defect in contents.defects:
                self._add_note(f'{defect}; {readable} could be read')

    def _add_note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

    def _parts_of_folder(self) -> list[Path]:
        """Return the storage files of a directory, in the order of its metadata."""
        # the parts of a split bag are numbered without leading zeros
        files = sorted((file for file in self.path.iterdir() if is_storage(file)),
                       key=lambda file: (len(file.name), file.name))
        metadata = self.path / 'metadata.yaml'
        if not files:
            raise InputError(f'{self.path} is not a bag: it has no .mcap, .db3 or .bag file')
        if not metadata.is_file():
            if files[0].suffix not in ('.bag', '.active'):
                self.notes.append(f'{self.path} has no metadata.yaml, probably because its '
                                  'recorder was killed; its storage files were read')
            return files
        try:
            known = parse_yaml(metadata.read_text(encoding='utf-8'))
            named = [self.path / Path(name).name for name in
                     known['rosbag2_bagfile_information']['relative_file_paths']]
        # noqa: BLE001 - damaged text can cause any exception
        except Exception:
            self.notes.append(f'{metadata} is damaged; the storage files beside it were read')
            return files
        found = {name: [file for file in files if file == name or file.stem == name.name]
                 for name in named}
        for name, matching in found.items():
            if not matching:
                self.complete = False
                self.notes.append(f'{self.path} has no {name.name}, which its metadata.yaml names: '
                                  'this part is missing')
        return [file for matching in found.values() for file in matching[:1]] or files


def is_storage(file: Path) -> bool:
    """Return whether a file is one of a recording, by its name."""
    return file.is_file() and bool(storage_name(file))


def storage_name(path: Path) -> str:
    """Return the name of a recording from that of its storage file; empty for another name."""
    stem = path.with_suffix('') if path.suffix in COMPRESSED else path
    return stem.stem if stem.suffix in READERS else ''


def _contents(part: Path, types: Collection[str] | None) -> Contents:
    """Return the messages of a file; one that is compressed is first decompressed."""
    if part.suffix not in COMPRESSED:
        return READERS[part.suffix](part, types)
    inner = part.with_suffix('').name
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, inner)
        defect = ''
        with part.open('rb') as source, file.open('wb') as target:
            blocks = iter(lambda: source.read(BLOCK), b'')
            try:
                target.writelines(decompressed_pieces(blocks, COMPRESSED[part.suffix]()))
            # noqa: BLE001 - damaged bytes can cause any exception in the libraries
            except Exception as error:
                defect = f'{part} is damaged and was decompressed in part ({error})'
        try:
            contents = READERS[file.suffix](file, types)
        except InputError as error:
            raise InputError(error.message.replace(str(file), str(part))) from None
    contents.defects = [each.replace(str(file), str(part)) for each in contents.defects]
    if defect:
        contents.miss(defect)
    return contents
