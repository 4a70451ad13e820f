# SPDX-License-Identifier: Apache-2.0
"""
A table on disk that grows by a row and can be continued.

Tab-separated: a comment line that says what it was made of, the names of the columns, then rows of
JSON values.  A row is either there whole or not at all.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gsdf_registration
from gsdf_registration.common.result import InputError

Row = dict[str, Any]    # column -> str, number, bool or None


class Journal:
    """
    The rows of a run by the name of their job, kept in a file if one is given.

    Parameters
    ----------
    path : the file, continued if it is there; None: nothing is kept
    about : what the rows depend on, JSON values: settings, versions, hashes of inputs

    Raises
    ------
    InputError
        If the file is no such table, or was made of something else.

    """

    def __init__(self, path: Path | None, about: Mapping[str, Any]) -> None:
        self.path = path
        self.rows: dict[str, Row] = {}
        self._columns: list[str] = []
        self._about = '# ' + json.dumps(about, sort_keys=True)
        if path is not None and path.exists() and path.stat().st_size:
            self._read(path)

    def add(self, name: str, row: Row) -> None:
        """Keep a row; it is on disk when this returns."""
        row = {'job': name, **row}
        self.rows[name] = row
        if self.path is None:
            return
        text = ''
        if not self._columns:
            self._columns = list(row)
            text = f'{self._about}\n' + '\t'.join(self._columns) + '\n'
        if list(row) != self._columns:
            raise ValueError(f'columns {list(row)} are not those of before, {self._columns}')
        with self.path.open('a', encoding='utf-8') as file:
            file.write(text + '\t'.join(json.dumps(value) for value in row.values()) + '\n')

    def _read(self, path: Path) -> None:
        """Take over the rows of a file; the piece of one that an interruption left is cut off."""
        try:
            text = path.read_text(encoding='utf-8')
        except UnicodeDecodeError:
            text = ''
        whole = text[:text.rfind('\n') + 1]
        lines = whole.splitlines()
        if len(lines) < 2 or not lines[0].startswith('# {'):
            raise InputError(f'{path} is no table of a benchmark; name another file')
        if lines[0] != self._about:
            raise InputError(f'{path} holds results of other {_differing(lines[0], self._about)}; '
                             'name another file, or remove it to start anew')
        self._columns = lines[1].split('\t')
        for number, line in enumerate(lines[2:], start=3):
            try:
                row = dict(zip(self._columns, map(json.loads, line.split('\t')), strict=True))
            except ValueError:
                raise InputError(f'{path}, line {number}: this is no row of the table; remove '
                                 'the line, and it is computed again') from None
            self.rows[row['job']] = row
        if whole != text:
            with path.open('rb+') as file:
                file.truncate(len(whole.encode()))


def source_hash() -> str:
    """Return the hash of all Python sources that an answer can depend on."""
    digest = hashlib.sha256()
    root = Path(gsdf_registration.__file__).parent
    for file in sorted(root.rglob('*.py')):
        if file.relative_to(root).parts[0] not in ('cli', 'node', 'report'):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _differing(before: str, now: str) -> str:
    """Name what differs between two comment lines."""
    try:
        a, b = json.loads(before[2:]), json.loads(now[2:])
    except ValueError:
        return 'inputs'
    return ', '.join(sorted(key for key in a.keys() | b.keys() if a.get(key) != b.get(key)))
