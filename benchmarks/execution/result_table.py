# SPDX-License-Identifier: Apache-2.0
"""
A table on disk to which rows are appended, and which a later run can continue.

Tab-separated: a comment line with what the rows depend on, the names of the columns, then rows of
JSON values. A row is written completely or not at all.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import benchmarks
import gsdf_registration
from gsdf_registration.common.result import InputError

# packages on which no answer depends
NOT_HASHED = ('cli', 'clients', 'commands', 'node', 'visualization')
Row = dict[str, Any]    # column -> str, number, bool or None


class ResultTable:
    """
    The rows of a run by the name of their job, stored in a file if one is given.

    Parameters
    ----------
    path : the file, continued if it exists; None: store nothing
    about : what the rows depend on, JSON values: settings, versions, hashes of inputs

    Raises
    ------
    InputError
        If the file is not such a table, or its rows depend on something else.

    """

    def __init__(self, path: Path | None, about: Mapping[str, Any]) -> None:
        self.path = path
        self.rows: dict[str, Row] = {}
        self._columns: list[str] = []
        self._about = '# ' + json.dumps(about, sort_keys=True)
        if path is not None and path.exists() and path.stat().st_size:
            self._read(path)

    def add(self, name: str, row: Row) -> None:
        """Append a row; it is on disk when this returns."""
        row = {'job': name, **row}
        self.rows[name] = row
        if self.path is None:
            return
        text = ''
        if not self._columns:
            self._columns = list(row)
            text = f'{self._about}\n' + '\t'.join(self._columns) + '\n'
        if list(row) != self._columns:
            raise ValueError(f'columns {list(row)} differ from {self._columns}')
        with self.path.open('a', encoding='utf-8') as file:
            file.write(text + '\t'.join(json.dumps(value) for value in row.values()) + '\n')

    def _read(self, path: Path) -> None:
        """Read the rows of a file; an incomplete last row is cut off."""
        try:
            text = path.read_text(encoding='utf-8')
        except UnicodeDecodeError:
            text = ''
        whole = text[:text.rfind('\n') + 1]
        lines = whole.splitlines()
        if len(lines) < 2 or not lines[0].startswith('# {'):
            raise InputError(f'{path} is not a table of a benchmark; give another file')
        if lines[0] != self._about:
            differing = _differing(lines[0], self._about)
            raise InputError(f'{path} contains results with other {differing}; give another file, '
                             'or delete it to start again')
        self._columns = lines[1].split('\t')
        for number, line in enumerate(lines[2:], start=3):
            try:
                row = dict(zip(self._columns, map(json.loads, line.split('\t')), strict=True))
            except ValueError:
                raise InputError(f'{path}, line {number}: this is not a row of the table; delete '
                                 'the line, and it is computed again') from None
            self.rows[row['job']] = row
        if whole != text:
            with path.open('rb+') as file:
                file.truncate(len(whole.encode()))


def source_hash() -> str:
    """Return the hash of all Python sources on which an answer can depend."""
    digest = hashlib.sha256()
    for package in (gsdf_registration, benchmarks):
        root = Path(str(package.__file__)).parent
        for file in sorted(root.rglob('*.py')):
            if file.relative_to(root).parts[0] not in NOT_HASHED:
                digest.update(file.read_bytes())
    return digest.hexdigest()


def _differing(before: str, now: str) -> str:
    """Return the keys that differ between two comment lines."""
    try:
        a, b = json.loads(before[2:]), json.loads(now[2:])
    except ValueError:
        return 'inputs'
    return ', '.join(sorted(key for key in a.keys() | b.keys() if a.get(key) != b.get(key)))
