# SPDX-License-Identifier: Apache-2.0
"""
The results of an archive on disk: a journal to which rows are appended, and tables made of it.

The journal (``journal.jsonl``) has one line for each row that was ever computed in this folder. A
row is written completely or not at all. The tables have the rows of one run, in its order.
"""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from gsdf_registration.cli.archive_row import COLUMNS, CRASHED, Row
from gsdf_registration.common.result import InputError

JOURNAL, CSV, PARQUET, PAGE, SETTINGS = ('journal.jsonl', 'results.csv', 'results.parquet',
                                         'summary.html', 'settings.json')
BATCH = 10_000      # rows that are converted at once


class Journal:
    """
    The rows that were computed in a folder; a row is found again by its place in the file.

    Parameters
    ----------
    folder : of the results; it is created

    Raises
    ------
    InputError
        If the folder cannot be written, or the journal is damaged.

    """

    def __init__(self, folder: Path) -> None:
        self._by_bag: dict[str, int] = {}       # places of earlier rows, by key and recording
        self._by_key: dict[str, int] = {}
        try:
            for name in ('', 'results', 'reports'):
                (folder / name).mkdir(parents=True, exist_ok=True)
            self._path = folder / JOURNAL
            self._file = self._path.open('a+b')
        except OSError as error:
            raise InputError(f'{folder} cannot be written: {error.strerror}') from None
        self._read()

    @property
    def is_empty(self) -> bool:
        """Whether there is no row of an earlier run."""
        return not self._by_key

    def earlier(self, key: str, bag: str) -> int | None:
        """Return the place of a row of an earlier run: of this recording, or of an equal one."""
        return self._by_bag.get(key + bag, self._by_key.get(key))

    def add(self, key: str, row: Row) -> int:
        """Append a row and return its place; it survives the end of this process."""
        place = self._file.seek(0, os.SEEK_END)
        line = json.dumps({'key': key, **{name: row[name] for name in COLUMNS}}, allow_nan=False)
        self._file.write(line.encode() + b'\n')
        self._file.flush()
        return place

    def row(self, place: int) -> Row:
        """Return the row at a place."""
        self._file.seek(place)
        row: Row = json.loads(self._file.readline())
        return {name: row.get(name) for name in COLUMNS}

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self) -> None:
        """Find the rows; an incomplete last line is cut off, and what crashed is tried again."""
        self._file.seek(0)
        place = 0
        for number, line in enumerate(self._file, start=1):
            if not line.endswith(b'\n'):
                break
            try:
                row = json.loads(line)
                key, bag, reason = row['key'], row['bag'], row['reason']
            except (ValueError, KeyError, TypeError):
                raise InputError(f'{self._path}, line {number}: this is not a row; delete the '
                                 'line, and its recording is registered again') from None
            if reason != CRASHED:
                self._by_bag[key + bag] = self._by_key[key] = place
            place += len(line)
        self._file.truncate(place)


def write_csv(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as CSV; an existing file is replaced when all are written."""
    from msg_adapters.files import write_atomically
    write_atomically(path, _csv_blocks(rows))


def _csv_blocks(rows: Iterable[Row]) -> Iterator[bytes]:
    yield (','.join(COLUMNS) + '\n').encode()
    source = iter(rows)
    while batch := list(islice(source, BATCH)):
        text = io.StringIO()
        csv.writer(text, lineterminator='\n').writerows(
            [_cell(row[name]) for name in COLUMNS] for row in batch)
        yield text.getvalue().encode()


def _cell(value: Any) -> str:
    if value is None:
        return ''
    return str(value).lower() if isinstance(value, bool) else str(value)


def read_csv(path: Path) -> Iterator[Row]:
    """
    Yield the rows of a table that `write_csv` wrote.

    Raises
    ------
    InputError
        If the file is missing or no such table.

    """
    from msg_adapters.files import read_text
    reader = csv.reader(io.StringIO(read_text(path)))
    header = next(reader)
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise InputError(f'{path} is no table of gsdf replay --output: it has no column '
                         f'"{missing[0]}"')
    for cells in reader:
        try:
            row = dict(zip(header, cells, strict=True))
            yield {name: _value(row[name], kind) for name, kind in COLUMNS.items()}
        except ValueError:
            raise InputError(f'{path}, line {reader.line_num}: this is not a row of the '
                             'table') from None


def _value(text: str, kind: type) -> Any:
    if not text:
        return '' if kind is str else None
    if kind is bool:
        return {'true': True, 'false': False}[text]
    return kind(text)


def write_parquet(path: Path, rows: Iterable[Row]) -> None:
    """
    Write rows as Parquet; an existing file is replaced when all are written.

    Raises
    ------
    InputError
        If pyarrow is not installed.

    """
    from msg_adapters.extras import needed
    arrow, parquet = (needed(name, 'dask', 'Parquet tables')
                      for name in ('pyarrow', 'pyarrow.parquet'))
    types = {str: arrow.string(), bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64()}
    schema = arrow.schema([(name, types[kind]) for name, kind in COLUMNS.items()])
    handle, temporary = tempfile.mkstemp(prefix=f'.{path.name}.', dir=path.parent)
    os.close(handle)
    try:
        with parquet.ParquetWriter(temporary, schema) as writer:
            source = iter(rows)
            while batch := list(islice(source, BATCH)):
                writer.write_table(arrow.Table.from_pylist(batch, schema=schema))
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def has_pyarrow() -> bool:
    """Return whether `write_parquet` can be used."""
    from importlib.util import find_spec
    return find_spec('pyarrow') is not None


def read_settings(folder: Path) -> dict[str, dict[str, Any]]:
    """
    Return the settings of a run, by their hash.

    Raises
    ------
    InputError
        If the file is missing or damaged.

    """
    from msg_adapters.files import read_json
    path = folder / SETTINGS
    try:
        return {key: dict(each['config']) for key, each in read_json(path).items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f'{path} is damaged; run gsdf replay --output again') from None
