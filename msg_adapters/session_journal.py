# SPDX-License-Identifier: Apache-2.0
"""
Journal of a session: every event is written as it happens, so that a killed node can resume.

The first line is ``{"schema": "gsdf-journal/1", ...}``.  Each further line is an event and its
value: ``["point", [1, 0, 1700000000.0125, 0.1, 0.2, -1.3]]``; `gsdf_registration.session.events`
lists the events.  Every event is passed to the operating system at once, so the death of the
process loses none; an incomplete last line is ignored.  To survive a power loss, use ``~/save``.

The file is created with the first event that is worth keeping.  An existing file, and the file of a
session that is cleared, is kept as ``.1``, and an earlier one as ``.2``.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsdf_registration import __version__
from gsdf_registration.common.result import InputError
from msg_adapters.files import write_atomically
from msg_adapters.session_file import now

SCHEMA = 'gsdf-journal/1'
PERSISTENT = frozenset({'model', 'collecting'})     # repeated at the start of the next file
WORTH_KEEPING = frozenset({'point', 'landmark', 'verification', 'registration', 'pose'})


def journal_path(session_path: str | os.PathLike[str]) -> Path:
    """Return the path of the journal of a session that is saved to ``session_path``."""
    return Path(f'{os.fspath(session_path)}.journal')


class SessionJournal:
    """
    A session listener (`Session.listen`) that writes the events to a file.

    Parameters
    ----------
    path : Path
    on_failure : callable
        Receives a sentence, once, when the file cannot be written; nothing else happens then.

    """

    def __init__(self, path: Path, on_failure: Callable[[str], None]) -> None:
        self.path = path
        self._on_failure = on_failure
        self._file: int | None = None
        self._persistent: dict[str, str] = {}
        self._pending: list[str] = []   # not written yet: nothing worth keeping, or only counts
        self._rejected: dict[str, int] = {}
        self._failed = False
        self._closed = False
        self._lock = threading.Lock()   # it may be closed while a registration still runs

    def __call__(self, event: str, value: Any) -> None:
        """Record an event; takes some microseconds for a point."""
        with self._lock:
            if not self._closed:
                self._record(event, value)

    def begin(self, session: dict[str, Any]) -> None:
        """Replace the file in one step by one that starts with ``session``, a session record."""
        with self._lock:
            self._begin(session)

    def close(self) -> None:
        """Write what is pending, and ignore further events."""
        with self._lock:
            if self._file is not None:
                self._write_pending()
            self._close_file()
            self._closed = True

    def _record(self, event: str, value: Any) -> None:
        if event == 'rejected':
            for cause, count in value.items():
                self._rejected[cause] = self._rejected.get(cause, 0) + count
        elif event in ('clear', 'session'):
            self._end_file(event == 'session')
            if event == 'session':
                self._begin(value)
        elif event in PERSISTENT:
            self._persistent[event] = _line(event, value)
            if self._file is not None:
                self._write(self._persistent[event])
        else:
            self._pending.append(_point_line(value) if event == 'point' else _line(event, value))
            if self._file is not None or event in WORTH_KEEPING:
                self._write_pending()

    def _begin(self, session: dict[str, Any]) -> None:
        try:
            _check_not_in_use(self.path)
            write_atomically(self.path, _head() + _line('session', session))
            self._open(os.O_WRONLY | os.O_APPEND)
        except (InputError, OSError) as error:
            self._fail(error)

    def _end_file(self, even_of_others: bool) -> None:
        """Set the present file aside; the next one starts with the next event worth keeping."""
        ours = self._file is not None
        self._close_file()
        self._pending, self._rejected, self._failed = [], {}, False
        if ours or even_of_others:
            try:
                _check_not_in_use(self.path)
                set_aside(self.path)
            except OSError as error:
                self._fail(error)

    def _write_pending(self) -> None:
        if self._rejected:
            self._pending.append(_line('rejected', self._rejected))
            self._rejected = {}
        self._write(''.join(self._pending))
        self._pending.clear()

    def _write(self, text: str) -> None:
        if self._failed:
            return
        try:
            if self._file is None:
                _check_not_in_use(self.path)
                set_aside(self.path)
                self._open(os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL)
                text = _head() + ''.join(self._persistent.values()) + text
            assert self._file is not None
            data = text.encode()
            if os.write(self._file, data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self._fail(error)

    def _open(self, flags: int) -> None:
        self._file = os.open(self.path, flags | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)
        self._file = None

    def _fail(self, error: Exception) -> None:
        self._close_file()
        if not self._failed:
            cause = error.strerror if isinstance(error, OSError) else error
            self._on_failure(f'the journal {self.path} cannot be written: {cause}; collecting '
                             'continues, but what follows is lost if the node crashes')
        self._failed = True


def read_journal(path: Path, apply: Callable[[str, Any], None]) -> str | None:
    """
    Pass the events of a journal, in order, to ``apply``.

    An incomplete last line is ignored.  Reading stops at a damaged line.

    Parameters
    ----------
    path : Path
    apply : callable
        Receives event and value.  If it raises ValueError, TypeError, KeyError, IndexError or
        AttributeError, the line is damaged.

    Returns
    -------
    str or None
        A sentence on the damaged line; empty if there is none.  None if there is no journal.

    Raises
    ------
    InputError
        If it is not a journal, cannot be read, or another node is writing it.

    """
    try:
        _check_not_in_use(path)
        *lines, _ = path.read_bytes().split(b'\n')     # a line without an end is incomplete
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f'{path} cannot be read: {error.strerror}') from None
    if not lines or not _is_head(lines[0]):
        raise InputError(f'{path} is not a journal of schema {SCHEMA}')
    for number, line in enumerate(lines[1:], 2):
        try:
            event, value = json.loads(line)
            apply(event, value)
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
            return f'line {number} of {path} is damaged; what follows is ignored'
    return ''


def set_aside(path: Path) -> Path | None:
    """
    Rename a journal to ``.1``, and an earlier ``.1`` to ``.2``; return its new path.

    None if there is no journal.  Raises OSError.
    """
    first, second = (path.with_name(f'{path.name}.{number}') for number in (1, 2))
    if not path.exists():
        return None
    if first.exists():
        os.replace(first, second)
    os.replace(path, first)
    return first


def _check_not_in_use(path: Path) -> None:
    """Raise OSError if another process, or another journal of this one, writes the file."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OSError(errno.EBUSY,
                      'another node writes it; give each node its own session.path') from None
    finally:
        os.close(file)


def _is_head(line: bytes) -> bool:
    try:
        head = json.loads(line)
    except ValueError:
        return False
    return isinstance(head, dict) and head.get('schema') == SCHEMA


def _head() -> str:
    return json.dumps({'schema': SCHEMA, 'begun': now(), 'version': __version__}) + '\n'


def _line(event: str, value: Any) -> str:
    return json.dumps([event, value], allow_nan=False) + '\n'


def _point_line(value: Any) -> str:
    """Return the same text as `_line`, in a fraction of the time."""
    stroke, source, stamp, x, y, z = value
    return f'["point", [{stroke}, {source}, {stamp!r}, {x!r}, {y!r}, {z!r}]]\n'
