# SPDX-License-Identifier: Apache-2.0
"""
What happens to a session, written line by line as it happens: a killed node goes on where it was.

The first line is ``{"schema": "gsdf-journal/1", ...}``; each further one is an event and its value,
see `gsdf_registration.session.events`: ``["point", [1, 0, 1700000000.0125, 0.1, 0.2, -1.3]]``.
Every event is handed to the system at once, so that the death of the process loses none; a last
line that is torn is left out.  Against a loss of power there is ``~/save``.

The file is made when there is something to keep.  One that is there already, and one whose session
is cleared, is kept as ``.1``, and that of before as ``.2``.
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
from gsdf_registration.session.events import Replay
from msg_adapters.files import write_atomically
from msg_adapters.session_file import now

SCHEMA = 'gsdf-journal/1'
STANDING = frozenset({'model', 'collecting'})   # what holds on in the next file
WORTH_KEEPING = frozenset({'point', 'landmark', 'verification', 'registration', 'pose'})


def journal_path(session_path: str | os.PathLike[str]) -> Path:
    """Return where the journal of a session lies that is saved to ``session_path``."""
    return Path(f'{os.fspath(session_path)}.journal')


class SessionJournal:
    """
    Listens to a session (`Session.listen`) and writes what it hears.

    Parameters
    ----------
    path : of the journal
    complain : is told, once, when that cannot be written; nothing else happens then

    """

    def __init__(self, path: Path, complain: Callable[[str], None]) -> None:
        self.path = path
        self._complain = complain
        self._file: int | None = None
        self._standing: dict[str, str] = {}
        self._ahead: list[str] = []     # heard, not written yet: nothing to keep, or only counts
        self._rejected: dict[str, int] = {}
        self._silent = False            # it failed
        self._closed = False
        self._lock = threading.Lock()   # it may be closed while a registration still runs

    def __call__(self, event: str, value: Any) -> None:
        """Take in an event; some microseconds for a point."""
        with self._lock:
            if not self._closed:
                self._take(event, value)

    def begin(self, session: dict[str, Any]) -> None:
        """Write anew, in one step, a journal that begins with ``session`` (`Session.to_dict`)."""
        with self._lock:
            self._begin(session)

    def close(self) -> None:
        """Write what is left, and no more from now on."""
        with self._lock:
            if self._file is not None:
                self._write_ahead()
            self._close_file()
            self._closed = True

    def _take(self, event: str, value: Any) -> None:
        if event == 'rejected':
            for cause, count in value.items():
                self._rejected[cause] = self._rejected.get(cause, 0) + count
        elif event in ('clear', 'session'):
            self._end_file(event == 'session')
            if event == 'session':
                self._begin(value)
        elif event in STANDING:
            self._standing[event] = _line(event, value)
            if self._file is not None:
                self._write(self._standing[event])
        else:
            self._ahead.append(_point_line(value) if event == 'point' else _line(event, value))
            if self._file is not None or event in WORTH_KEEPING:
                self._write_ahead()

    def _begin(self, session: dict[str, Any]) -> None:
        try:
            _refuse_if_in_use(self.path)
            write_atomically(self.path, _head() + _line('session', session))
            self._open(os.O_WRONLY | os.O_APPEND)
        except (InputError, OSError) as error:
            self._fail(error)

    def _end_file(self, even_of_others: bool) -> None:
        """Keep what was written aside; the next file begins with the next thing to keep."""
        ours = self._file is not None
        self._close_file()
        self._ahead, self._rejected, self._silent = [], {}, False
        if ours or even_of_others:
            try:
                _refuse_if_in_use(self.path)
                set_aside(self.path)
            except OSError as error:
                self._fail(error)

    def _write_ahead(self) -> None:
        if self._rejected:
            self._ahead.append(_line('rejected', self._rejected))
            self._rejected = {}
        self._write(''.join(self._ahead))
        self._ahead.clear()

    def _write(self, text: str) -> None:
        if self._silent:
            return
        try:
            if self._file is None:
                _refuse_if_in_use(self.path)
                set_aside(self.path)
                self._open(os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL)
                text = _head() + ''.join(self._standing.values()) + text
            assert self._file is not None
            data = text.encode()
            if os.write(self._file, data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self._fail(error)

    def _open(self, how: int) -> None:
        self._file = os.open(self.path, how | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)
        self._file = None

    def _fail(self, error: Exception) -> None:
        self._close_file()
        if not self._silent:
            words = error.strerror if isinstance(error, OSError) else error
            self._complain(f'the journal {self.path} cannot be written: {words}; collecting goes '
                           'on, but after a crash what comes from now on is not found again')
        self._silent = True


def read_journal(path: Path) -> tuple[dict[str, Any], str] | None:
    """
    Return the session that a journal leads to, as `Session.to_dict`; None if there is no journal.

    A last line that is torn is left out.  Where a line is damaged, what comes before it is taken,
    and the sentence returned says so; else that is empty.

    Raises
    ------
    InputError
        If it is no journal, cannot be read, or another node is writing it.

    """
    try:
        _refuse_if_in_use(path)
        *lines, _ = path.read_bytes().split(b'\n')     # what follows the last line end is torn
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f'{path} cannot be read: {error.strerror}') from None
    if not lines or not _is_head(lines[0]):
        raise InputError(f'{path} is no journal of schema {SCHEMA}')
    replay = Replay()
    for number, line in enumerate(lines[1:], 2):
        try:
            event, value = json.loads(line)
            replay.take(event, value)
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
            return replay.session, f'line {number} of {path} is damaged; what follows is left out'
    return replay.session, ''


def set_aside(path: Path) -> Path | None:
    """
    Rename a journal to ``.1``, the one so named before to ``.2``; return its new name.

    None if there is none.  Raises OSError.
    """
    first, second = (path.with_name(f'{path.name}.{number}') for number in (1, 2))
    if not path.exists():
        return None
    if first.exists():
        os.replace(first, second)
    os.replace(path, first)
    return first


def _refuse_if_in_use(path: Path) -> None:
    """Raise OSError if another process, or another journal of this one, writes the file."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OSError(errno.EBUSY, 'another node writes it; give each a session.path') from None
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
    """Return what `_line` would, in a fraction of the time."""
    stroke, source, stamp, x, y, z = value
    return f'["point", [{stroke}, {source}, {stamp!r}, {x!r}, {y!r}, {z!r}]]\n'
