# SPDX-License-Identifier: Apache-2.0
"""Read the messages of a sqlite3 file of rosbag2 (.db3), up to the place where it is damaged."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection
from contextlib import closing
from pathlib import Path

from gsdf_registration.common.result import InputError
from msg_adapters.stored import Contents, StoredMessage


def read_sqlite(path: Path, wanted: Collection[str] | None = None) -> Contents:
    """Return the messages of a file, see `mcap_file.read_mcap`; `InputError` if it has none."""
    found = Contents()
    try:
        with closing(sqlite3.connect(f'{path.absolute().as_uri()}?mode=ro', uri=True)) as file:
            names = {number: (str(name), str(kind))
                     for number, name, kind in file.execute('SELECT id, name, type FROM topics')}
            _read_messages(file, path, names, wanted, found)
    except (sqlite3.Error, ValueError, TypeError) as error:
        raise InputError(f'{path} is damaged, truncated or no bag ({error})') from None
    for name in names.values():
        found.counts.setdefault(name, 0)
    return found


def _read_messages(file: sqlite3.Connection, path: Path, names: dict[int, tuple[str, str]],
                   wanted: Collection[str] | None, found: Contents) -> None:
    """Read the messages in the order of their rows: that needs no index, which may be damaged."""
    last = 0
    try:
        for row, number, time, data in file.execute(
                'SELECT id, topic_id, timestamp, data FROM messages ORDER BY id'):
            last = row
            if number not in names or not isinstance(data, bytes):
                found.miss(f'{path}: the message in row {row} is damaged and left out')
                continue
            found.counts[names[number]] += 1
            if wanted is None or names[number][1] in wanted:
                found.messages.append(StoredMessage(int(time), *names[number], data))
    except sqlite3.Error as error:
        found.miss(f'{path} is damaged or truncated after the message in row {last} ({error}); '
                   'what follows is lost')
