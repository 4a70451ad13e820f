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
- ``air``: positions of the tip in the air, followed by the pose of the tool if it is known;
- ``columns``: names of the numbers of a point: stroke, number of its source (from 0), stamp,
  position, and its residual and weight in the accepted registration;
- ``points``: one per line;
- ``sha256``: of all lines before this one, without the last comma.

A file whose checksum does not fit is not read.  A session file that contains another session is
kept under another name when a session is written in its place.  Any other file is left alone.
"""

from __future__ import annotations

import datetime
import hashlib
import itertools
import json
import os
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import shortened
from msg_adapters.files import (
    absolute_path,
    irregular,
    keep_with_date,
    open_file,
    write_atomically,
)
from msg_adapters.point_lines import lines_of, points_of

SCHEMA = 'gsdf-session/3'
SUFFIX = '.json'
MAX_NAME = 200      # bytes of a file name, so that journals and backups can have longer ones
MAX_SIZE = 256_000_000      # bytes of a file that is read; 200,000 points take 25 MB
MAX_LINE = 1 << 20      # bytes read at a time
_SCHEMA = re.compile(rb'\s*\{\s*"schema"\s*:\s*"(gsdf-session/\d+)"')
_POINTS = b'  "points": ['  # the line before the points
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
    Write a session record (`Session.to_dict`) in one step, and a part at a time.

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
    points = session['points']
    head = {'schema': SCHEMA, 'saved': now()} | session | {'columns': list(points.dtype.names)}
    del head['points']
    try:
        text = ''.join(_lines(head)).removesuffix('\n}')
    except (TypeError, ValueError) as error:
        raise InputError(f'{path}: the session cannot be written as JSON: {error}') from None
    end = '\n  ]' if len(points) else ']'
    blocks = itertools.chain([text, ',\n  "points": ['], lines_of(points), [end])
    _check_replaceable(path)

    def keep() -> None:
        nonlocal kept
        present = identity(path)
        if present is not None and present != replaces:
            _check_replaceable(path)
            kept = keep_with_date(path)

    write_atomically(path, _signed(blocks), before=keep)
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
            schema = _SCHEMA.match(file.read(256))
            if schema is None or schema[1].decode() != SCHEMA:
                older = schema is not None and schema[1] in (b'gsdf-session/1', b'gsdf-session/2')
                raise InputError(f'{path} is not a session of schema {SCHEMA}' + (
                    ', but of an earlier one without a checksum' if older else ''))
            file.seek(0)
            return _parsed(_checked(file))
        except OSError as error:
            raise InputError(f'{path} cannot be read: {error.strerror}') from None
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            raise InputError(f'{path} is damaged: its content does not fit its checksum; load '
                             'another session file') from None


def _signed(blocks: Iterable[str]) -> Iterator[bytes]:
    """Yield the blocks, and the checksum after them."""
    digest = hashlib.sha256()
    for block in blocks:
        data = block.encode()
        digest.update(data)
        yield data
    yield _end(digest.hexdigest())


def _end(sha256: str) -> bytes:
    """Return the end of a file with this checksum."""
    return f',\n  "sha256": "{sha256}"\n}}\n'.encode()


def _checked(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines before the checksum; raise ValueError after them if it does not fit."""
    digest, held = hashlib.sha256(), deque[bytes]()
    for line in iter(lambda: file.readline(MAX_LINE), b''):
        held.append(line)
        if len(held) > 3:
            digest.update(held[0])
            yield held.popleft()
    last = held[0].removesuffix(b',\n')
    digest.update(last)
    yield last
    if b''.join(held) != last + _end(digest.hexdigest()):
        raise ValueError('the checksum does not fit')


def _parsed(lines: Iterator[bytes]) -> dict[str, Any]:
    """Return the session in these lines, which end before the last brace."""
    head = itertools.takewhile(lambda line: not line.startswith(_POINTS), lines)
    session: dict[str, Any] = json.loads(b''.join(head).removesuffix(b',\n') + b'}')
    rows = itertools.takewhile(lambda line: line != b'  ]', lines)
    session['points'] = points_of(rows, session.pop('columns'))
    if any(True for _ in lines):    # also checks the checksum
        raise ValueError('the points are not the last')
    return session


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
