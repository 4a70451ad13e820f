# SPDX-License-Identifier: Apache-2.0
"""
A session file: readable JSON with a checksum, written in one step.

Schema "gsdf-session/3"; SI units, frames by name; null means unknown:

- ``saved``: the time; ``versions``: of the software; ``model_sha256``: of the bone model;
- ``frames``: of the ``points``, of the accepted ``pose``, and of the ``bone``;
- ``collecting``: whether points were being collected; ``sources``: the topics of the points;
- ``rejected``: number of rejected samples by cause;
- ``landmarks``: name, model position, position of the stationary tip, its spread, stamp;
- ``verifications``: position of the stationary tip, distance to the surface, stamp, number of the
  checkpoint and how far it has moved since it was first touched;
- ``result``: the last registration; ``pose_result``: the accepted registration;
- ``parameters``: the settings by dotted name;
- ``points``: one per line, with the columns in ``columns``: stroke, number of its source (from 0),
  stamp, position, and its residual and weight in the accepted registration;
- ``sha256``: of all lines before this one, without the last comma.

A file whose checksum does not fit is not read.  A session file that contains another session is
kept under another name when a session is written in its place.  Any other file is left alone.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import shortened
from msg_adapters.files import absolute_path, irregular, open_file, write_atomically

SCHEMA = 'gsdf-session/3'
SUFFIX = '.json'
MAX_NAME = 200      # bytes of a file name, so that journals and backups can have longer ones
MAX_SIZE = 256_000_000      # bytes of a file that is read; 200,000 points take 25 MB
PART = 1000         # points
_SCHEMA = re.compile(rb'\s*\{\s*"schema"\s*:\s*"(gsdf-session/\d+)"')
_CHECKSUM = re.compile(rb',\n  "sha256": "([0-9a-f]{64})"\n\}\n\Z')
_encode = json.JSONEncoder(allow_nan=False).encode

Identity = tuple[int, int, int, int]


def session_path(path: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a session file; `InputError` unless it can be the name of one."""
    found = absolute_path(path)
    if found.suffix != SUFFIX:
        raise InputError(f'session.path {shortened(str(path))}: the name of a session file ends '
                         f'with {SUFFIX}')
    if len(os.fsencode(found.name)) > MAX_NAME:
        raise InputError(f'session.path: the file name is longer than {MAX_NAME} bytes')
    return found


def write_session(path: str | os.PathLike[str], session: dict[str, Any],
                  replaces: Identity | None = None) -> Path | None:
    """
    Write a session record (`Session.to_dict`) in one step.

    Parameters
    ----------
    path
    session : dict
    replaces : Identity, optional
        Of the file that may be replaced, see `identity`; any other session file is kept.

    Returns
    -------
    Path or None
        Where the session file that was there before is kept; None if there was none, or it is
        replaced.

    Raises
    ------
    InputError
        If the file cannot be written, is not a session file, or a value is not finite or not plain;
        nothing is changed then.

    """
    path, kept = Path(path), None
    try:
        text = ''.join(_lines({'schema': SCHEMA, 'saved': now()} | session))
    except (TypeError, ValueError) as error:
        raise InputError(f'{path}: the session cannot be written as JSON: {error}') from None
    text = text.removesuffix('\n}')
    text += f',\n  "sha256": "{hashlib.sha256(text.encode()).hexdigest()}"\n}}\n'
    _check_replaceable(path)

    def keep() -> None:
        nonlocal kept
        present = identity(path)
        if present is not None and present != replaces:
            _check_replaceable(path)
            kept = _keep(path)

    write_atomically(path, text, before=keep)
    return kept


def read_session(path: str | os.PathLike[str], limit: int = MAX_SIZE) -> dict[str, Any]:
    """
    Read a session record from a file of at most ``limit`` bytes.

    Raises
    ------
    InputError
        If the file is missing, damaged or too large, or has another schema.

    """
    with open_file(path, limit) as file:
        try:
            content = file.read(limit)
        except OSError as error:
            raise InputError(f'{path} cannot be read: {error.strerror}') from None
    schema = _SCHEMA.match(content)
    if schema is None or schema[1].decode() != SCHEMA:
        older = schema is not None and schema[1] in (b'gsdf-session/1', b'gsdf-session/2')
        raise InputError(f'{path} is not a session of schema {SCHEMA}' + (
            ', but of an earlier one without a checksum' if older else ''))
    end = _CHECKSUM.search(content, max(len(content) - 100, 0))
    if end is None or end[1].decode() != hashlib.sha256(content[:end.start()]).hexdigest():
        raise InputError(f'{path} is damaged: its content does not fit its checksum; load another '
                         'session file')
    try:
        return _parsed(content[:end.start()])
    except (ValueError, RecursionError):
        raise InputError(f'{path} is damaged: it is not valid JSON') from None


def _parsed(content: bytes) -> dict[str, Any]:
    """Return a session from JSON without its last brace; many points are parsed in parts."""
    # json holds the interpreter lock while it parses: a part takes some milliseconds
    content, begin, rows = content.partition(b',\n  "points": [\n')
    if not (begin and rows.endswith(b'\n  ]')):
        return dict(json.loads(content + begin + rows + b'}'))
    lines = rows.removesuffix(b'\n  ]').split(b',\n')
    points = []
    for first in range(0, len(lines), PART):
        points += json.loads(b'[' + b','.join(lines[first:first + PART]) + b']')
    return {**json.loads(content + b'}'), 'points': points}


class SessionFile:
    """
    A listener of a session (`Session.listen`) that knows whether a file contains this session.

    The file that was loaded or saved last does, until a new session begins.
    """

    def __init__(self) -> None:
        self._identity: Identity | None = None
        self._model: Any = None
        self._generation = 0

    def __call__(self, event: str, value: Any) -> None:
        """Follow a session; another one begins with a clear, with another bone, and when loaded."""
        if event in ('clear', 'session') or (event == 'model' and value != self._model):
            self._identity = None
            self._generation += 1
        if event == 'model':
            self._model = value

    def save(self, path: Path, session: Callable[[], dict[str, Any]]) -> tuple[int, Path | None]:
        """Write ``session()``; return its number of points, and the path of a file that is kept."""
        generation = self._generation
        record = session()
        kept = write_session(path, record, self._identity)
        if generation == self._generation:
            self._identity = identity(path)
        return len(record['points']), kept

    def load(self, path: Path, limit: int, restore: Callable[[dict[str, Any]], None]) -> None:
        """Read a session record and pass it to ``restore``."""
        present = identity(path)
        restore(read_session(path, limit))
        self._identity = present


def identity(path: Path) -> Identity | None:
    """Return what changes whenever another file is at ``path``, or its content changes."""
    try:
        found = os.lstat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def now() -> str:
    """Return the present time in UTC, to the second."""
    return datetime.datetime.now(datetime.timezone.utc).isoformat(timespec='seconds')


def _check_replaceable(path: Path) -> None:
    """Raise `InputError` if there is something else at ``path`` than a session file."""
    try:
        found = irregular(path)
        if not found and path.exists():
            with path.open('rb') as file:
                found = '' if _SCHEMA.match(file.read(256)) else 'no session file'
    except OSError as error:
        raise InputError(f'{path} cannot be written: {error.strerror}') from None
    if found:
        raise InputError(f'{path} is {found}, so it is not overwritten; set another session.path')


def _keep(path: Path) -> Path:
    """Give the file at ``path`` another name, with its date; ``path`` may stay or not."""
    date = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.timezone.utc)
    stem, number = f'{path.stem}.{date:%Y-%m-%dT%H-%M-%SZ}', 1
    while True:
        kept = path.with_name(f'{stem}{"" if number == 1 else f"-{number}"}{path.suffix}')
        try:
            os.link(path, kept)     # never overwrites
            return kept
        except FileExistsError:
            number += 1
        except OSError:     # a file system without hard links
            if kept.exists():
                number += 1
                continue
            os.rename(path, kept)
            return kept


def _lines(value: Any, indent: str = '') -> Iterator[str]:
    """Yield JSON text with every list of plain numbers or strings on one line."""
    inner = indent + '  '
    if isinstance(value, dict) and value:
        for count, (key, item) in enumerate(value.items()):
            yield f'{"," if count else "{"}\n{inner}{_encode(key)}: '
            yield from _lines(item, inner)
        yield f'\n{indent}}}'
    elif isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value):
        for count, item in enumerate(value):
            yield f'{"," if count else "["}\n{inner}'
            yield from _lines(item, inner)
        yield f'\n{indent}]'
    else:
        yield _encode(value)
