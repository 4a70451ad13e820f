# SPDX-License-Identifier: Apache-2.0
"""
Journal of a session: every event is written as it happens, so that a killed node can resume.

The first line is ``{"schema": "gsdf-journal/3", ...}``.  Each further line is an event, its value
and a checksum: ``["point", [1, 0, 1700000000.0125, 0.1, 0.2, -1.3], "9b2f01aa"]``;
`gsdf_registration.session.events` lists the events.  A checksum is the CRC-32 of the line up to it,
continued from the line before, so that a line that is changed, missing or moved is found.  What
follows such a line is not read: it may depend on it, as the points of a stroke on its undo.  Rows
are packed, see `packed_rows`; a whole session is followed by events with its points, in parts.

Every event is passed to the operating system at once, so the death of the process loses none.  To
survive a power loss, use ``~/save``.

The file is created with the first event that is worth keeping.  An existing file, and the file of a
session that is cleared, is kept as ``.1``, and an earlier one as ``.2``.  If it cannot be renamed,
the next session continues in the same file.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import json
import os
import tempfile
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from gsdf_registration import __version__
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from msg_adapters.files import irregular, open_file
from msg_adapters.packed_rows import packed, unpacked
from msg_adapters.session_file import now

SCHEMA = 'gsdf-journal/3'
OF_THE_PROBE = ('tip', 'tip_radius', 'tip_error')
# repeated at the start of the next file
PERSISTENT = frozenset({'model', 'collecting', *OF_THE_PROBE})
WORTH_KEEPING = frozenset({'point', 'landmark', 'verification', 'registration'})
MAX_SIZE = 1_000_000_000    # bytes of a journal that is read
MAX_HEAD = 1000
RENEW_SIZE = 100_000_000    # bytes; a journal is begun again when so much has been appended
PART = 10_000       # points in one line
_START = zlib.crc32(SCHEMA.encode())    # the checksum before the first event
_TAIL = len(b', "01234567"]')
_encode = json.JSONEncoder(allow_nan=False, default=packed).encode


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
        Receives a sentence when the file cannot be written; nothing else happens then.
    continues : bool
        Whether the session was read from the file, so that the file is replaced and not kept.

    """

    def __init__(self, path: Path, on_failure: Callable[[str], None],
                 continues: bool = False) -> None:
        self.path = path
        self.problem = ''       # why the events are not written; empty while they are
        self.on_failure = on_failure
        self._reported = ''
        self._file: int | None = None
        self._own = _identity(path) if continues else None     # of the file that contains all this
        self._renewing = continues
        self._checksum = self._appended = 0
        self._base: dict[str, Any] = {}     # the session at the start of the file
        self._persistent: dict[str, str] = {}
        self._pending: list[str] = []   # not written yet: nothing worth keeping, or only counts
        self._rejected: dict[str, int] = {}
        self._outdated = False      # whether a file at `path` could not be set aside
        self._closed = False
        self._lock = threading.Lock()   # it may be closed while a registration still runs

    def __call__(self, event: str, value: Any) -> None:
        """Record an event; takes some microseconds for a point."""
        with self._lock:
            if not self._closed:
                try:
                    self._record(event, value)
                except (OSError, ValueError, TypeError) as error:
                    self._fail(error)

    def renew(self) -> None:
        """Let the next 'session' event replace the file, instead of setting it aside."""
        with self._lock:
            self._renewing = True

    @property
    def too_long(self) -> bool:
        """Whether it is time to renew the file."""
        return self._appended > RENEW_SIZE

    def close(self) -> None:
        """Write what is pending, and ignore further events."""
        with self._lock:
            if self._file is not None and not self._closed:
                try:
                    self._write_pending()
                except (OSError, ValueError, TypeError) as error:
                    self._fail(error)
            self._close_file()
            self._closed = True

    def retire(self) -> Path | None:
        """Close the journal and set its file aside; return its new path.  Raises OSError."""
        self.close()
        ours = self._own is not None and self._own == _identity(self.path)
        return set_aside(self.path) if ours else None

    @property
    def writing(self) -> bool:
        """Whether there is a file to which events are written."""
        return self._file is not None

    def _record(self, event: str, value: Any) -> None:
        if event == 'session':
            self._begin(value)
        elif event == 'clear':
            self._end([_body('clear', value)])
        elif event in PERSISTENT:
            self._persistent[event] = _body(event, value)
            if self._file is not None:
                self._append([self._persistent[event]])
        elif self.problem:
            return      # renewing the file writes the whole session
        elif event == 'rejected':
            for cause, count in value.items():
                self._rejected[cause] = self._rejected.get(cause, 0) + count
        else:
            self._pending.append(_body(event, value))
            if self._file is not None or event in WORTH_KEEPING:
                self._write_pending()

    def _begin(self, session: dict[str, Any]) -> None:
        """Start a file with a whole session."""
        persistent = {'model': _body('model', session['model_sha256']),
                      'collecting': _body('collecting', session['collecting'])}
        for name in OF_THE_PROBE:
            value = session['parameters'].get(f'probe.{name}')
            if value:
                persistent[name] = _body(name, value)
        if self._renewing:
            self._close_file()
        elif self._end(_session_bodies(session)):
            self._persistent = persistent
            return
        self._pending, self._rejected, self.problem = [], {}, ''
        self._base, self._persistent = session, persistent
        if len(session['points']) or any(session[key] for key in (
                'landmarks', 'verifications', 'pose_result')):
            self._create()
        elif self._outdated:
            self._set_aside()

    def _end(self, bodies: Iterable[str]) -> bool:
        """
        Set the present file aside; the next one starts with the next event worth keeping.

        If the file cannot be renamed, as in a folder that has become read-only, write ``bodies``,
        the events that end the session, go on in the same file, and return True.
        """
        self._outdated |= self._own is not None and self._own == _identity(self.path)
        try:
            if self._outdated:
                self._set_aside()
        except OSError:
            if self._file is None:
                raise
            self._write_pending()
            self._append(bodies)
            self._outdated = False
            return True
        finally:
            self._base, self._rejected, self._renewing = {}, {}, False
        self._close_file()
        self._pending, self._own, self.problem = [], None, ''
        return False

    def _set_aside(self) -> None:
        if self._file is None:
            check_not_in_use(self.path)
        set_aside(self.path)
        self._outdated = False

    def _write_pending(self) -> None:
        if self._rejected:
            self._pending.append(_body('rejected', self._rejected))
            self._rejected = {}
        if self._file is None:
            self._create()
        else:
            self._append(self._pending)
        self._pending.clear()

    def _create(self) -> None:
        """Create the file, with what is pending, in one step."""
        check_not_in_use(self.path)
        bodies = itertools.chain(_session_bodies(self._base), self._persistent.values(),
                                 self._pending)
        handle, temporary = tempfile.mkstemp(prefix=f'.{self.path.name[:64]}.',
                                             dir=self.path.parent)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with contextlib.suppress(OSError):      # not every file system has permissions
                os.fchmod(handle, 0o644)    # mkstemp lets only the owner read
            _write_all(handle, _head().encode())
            checksum = _write_chained(handle, bodies, _START)[0]
            if self._own is None or self._own != _identity(self.path):
                set_aside(self.path)
            os.replace(temporary, self.path)
        except BaseException:
            os.close(handle)
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
        self._file, self._own = handle, _identity(self.path)
        self._renewing = self._outdated = False
        self._checksum, self._appended, self._base = checksum, 0, {}
        self._pending, self._reported = [], ''

    def _append(self, bodies: Iterable[str]) -> None:
        assert self._file is not None
        if _identity(self.path) != self._own:
            raise OSError(errno.ENOENT, 'it was deleted or replaced')
        size = os.fstat(self._file).st_size
        try:
            self._checksum, written = _write_chained(self._file, bodies, self._checksum)
        except (OSError, ValueError, TypeError):
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, size)
            raise
        self._appended += written

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)
        self._file = None

    def _fail(self, error: Exception) -> None:
        self._close_file()
        self._pending, self._rejected = [], {}
        cause = (error.strerror if isinstance(error, OSError) else None) or error
        self.problem = (f'the journal {self.path} cannot be written: {cause}; points are now lost '
                        'if the node crashes: make room or change session.path, and save')
        if self.problem != self._reported:
            self._reported = self.problem
            self.on_failure(self.problem)


def read_journal(path: Path, apply: Callable[[str, Any], None]) -> str | None:
    """
    Pass the events of a journal, in order, to ``apply``; stop at a damaged line.

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
        check_not_in_use(path)
        if not os.path.lexists(path):
            return None
        with open_file(path, MAX_SIZE) as file:
            return _read_lines(path, file, apply)
    except OSError as error:
        raise InputError(f'{path} cannot be read: {error.strerror}') from None


def _read_lines(path: Path, file: BinaryIO, apply: Callable[[str, Any], None]) -> str:
    headed, checksum, applied = _is_head(file.readline(MAX_HEAD)), _START, 0
    damage = '' if headed else f'line 1 of {path} is damaged'
    for number, line in enumerate(file, 2):
        checksum, valid = _apply_line(line, checksum, apply)
        if not valid:
            following = sum(1 for _ in file)
            damage = f'line {number} of {path} is damaged' + (
                f'; {format_count(following, "line")} after it ignored' if following else '')
            break
        applied += 1
    if not headed and not applied:
        raise InputError(f'{path} is not a journal of schema {SCHEMA}')
    return damage


def _apply_line(line: bytes, checksum: int, apply: Callable[[str, Any], None]) -> tuple[int, bool]:
    """Pass one event to ``apply``; return the checksum after it, and whether it is valid."""
    body = line[:-_TAIL - 1]
    checksum = zlib.crc32(body, checksum)
    if line[len(body):] != f', "{checksum:08x}"]\n'.encode():
        return checksum, False
    try:
        apply(*json.loads(body + b']', object_hook=unpacked))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
        return checksum, False
    return checksum, True


def set_aside(path: Path) -> Path | None:
    """
    Rename a journal to ``.1``, and an earlier ``.1`` to ``.2``; return its new path.

    None if there is no journal.  Raises OSError, also if one of them is not a regular file.
    """
    first, second = (path.with_name(f'{path.name}.{number}') for number in (1, 2))
    if not os.path.lexists(path):
        return None
    for each in (path, first, second):
        _check_regular(each)
    if first.exists():
        os.replace(first, second)
    os.replace(path, first)
    return first


def _check_regular(path: Path) -> None:
    found = irregular(path)
    if found:
        raise OSError(errno.EINVAL, f'{path.name} is {found}')


def check_not_in_use(path: Path) -> None:
    """Raise OSError if another process, or another journal of this one, writes the file."""
    try:
        _check_regular(path)
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OSError(errno.EBUSY,
                      'another node writes it; give each node its own session.path') from None
    finally:
        os.close(file)


def _identity(path: Path) -> tuple[int, int] | None:
    """Return device and number of the file at ``path``; None if there is none."""
    try:
        found = os.lstat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _write_all(file: int, data: bytes) -> None:
    if os.write(file, data) < len(data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _is_head(line: bytes) -> bool:
    try:
        head = json.loads(line)
    except (ValueError, RecursionError):
        return False
    return isinstance(head, dict) and head.get('schema') == SCHEMA and line.endswith(b'\n')


def _head() -> str:
    return json.dumps({'schema': SCHEMA, 'begun': now(), 'version': __version__}) + '\n'


def _write_chained(file: int, bodies: Iterable[str], checksum: int) -> tuple[int, int]:
    """Write the lines of these events; return the checksum after them, and their size in bytes."""
    written = 0
    for body in bodies:
        data = body.encode()
        checksum = zlib.crc32(data, checksum)
        line = data + b', "%08x"]\n' % checksum
        _write_all(file, line)
        written += len(line)
    return checksum, written


def _session_bodies(session: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a whole session: first without its points, then these in parts."""
    if session:
        points = session['points']
        yield _body('session', session | {'points': points[:0]})
        for first in range(0, len(points), PART):
            part = packed(points[first:first + PART])
            rows = part.pop('rows')     # which the encoder would check letter by letter
            yield f'{_body("points", part)[:-1]}, "rows": "{rows}"}}'


def _body(event: str, value: Any) -> str:
    """Return the line of an event up to its checksum."""
    return _encode([event, value])[:-1]
