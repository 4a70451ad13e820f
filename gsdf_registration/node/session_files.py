# SPDX-License-Identifier: Apache-2.0
"""The files of the node's session: the session file, and the journal that follows every change."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from rclpy.impl.rcutils_logger import RcutilsLogger

from gsdf_registration.common.config import SessionConfig
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import shortened
from gsdf_registration.session import Session
from gsdf_registration.session.events import Replay
from gsdf_registration.tracking.pivot import FixedPoint
from msg_adapters.session_file import MAX_SIZE, SessionFile, session_path
from msg_adapters.session_journal import (
    SessionJournal,
    check_not_in_use,
    journal_path,
    read_journal,
    set_aside,
)
from msg_adapters.tip_file import tip_path, write_tip

RETRY = 10.0        # s until a journal that could not be written is tried again
ROW_SIZE = 200      # bytes of a point in a session file, at most


class SessionFiles:
    """
    Saves and loads the session of a node, and keeps its journal.

    A journal that cannot be written never stops the node: `problem` says why, and what to do.
    """

    def __init__(self, log: RcutilsLogger) -> None:
        self._log = log
        self._session: Session | None = None
        self._journal: SessionJournal | None = None
        self._file = SessionFile()
        self._next_try = 0.0

    @property
    def problem(self) -> str:
        """Why changes of the session are not written to the journal; empty if they are."""
        return '' if self._journal is None else self._journal.problem

    def open(self, session: Session, config: SessionConfig) -> None:
        """
        Start to follow ``session``.

        If ``session.resume``, it is first loaded from the journal of ``session.path``.  Log and
        status say whether that worked.
        """
        self.close()
        path, resumed = journal_path(session_path(config.path)), False
        if config.resume:
            try:
                resumed, notice = _resume(session, path)
                self._log.info(notice)
                session.set_notice(notice if resumed else '')
            except InputError as error:
                notice = f'nothing is resumed: {error.message}'
                self._log.error(notice)
                session.set_notice(notice, warning=True)
        journal = SessionJournal(path, self._log.warning, continues=resumed)
        session.listen(journal, from_start=True)
        self._file = SessionFile()
        session.listen(self._file)
        self._session, self._journal = session, journal

    def close(self) -> None:
        """End the journal."""
        if self._journal is not None:
            self._journal.close()
        self._session = self._journal = None

    def move(self, config: SessionConfig) -> None:
        """
        Continue the journal beside ``session.path``, if that has changed.

        The new journal starts with the whole session before the former one ends.  Raises
        `InputError`, changing nothing, if it cannot be written.
        """
        path = journal_path(session_path(config.path))
        session, former = self._session, self._journal
        if session is None or former is None or path == former.path:
            return
        moved = SessionJournal(path, lambda problem: None)
        try:
            check_not_in_use(path)
            with tempfile.TemporaryFile(dir=path.parent):   # is there a folder to write to?
                pass
            session.listen(moved, from_start=True)
        except OSError as error:
            raise InputError(f'session.path {shortened(config.path)} cannot be written: '
                             f'{error.strerror}; {former.path} is kept') from None
        if moved.problem:
            session.stop_listening(moved)
            raise InputError(f'session.path {shortened(config.path)}: '
                             f'{moved.problem.partition(";")[0]}; '
                             f'{former.path} is kept')
        moved.on_failure = self._log.warning
        self._journal = moved
        session.stop_listening(former)
        self._log.info(f'the journal is now {path}{_retired(former)}')

    def check(self) -> None:
        """Try again to write a journal that could not be written; to be called once a second."""
        session, journal, now = self._session, self._journal, time.monotonic()
        if (session is None or journal is None or now < self._next_try
                or not (journal.problem or journal.too_long)):
            return
        self._next_try = now + RETRY
        problem = journal.problem
        journal.renew()
        session.stop_listening(journal)
        session.listen(journal, from_start=True)
        if problem and journal.writing:
            self._log.info(f'the journal {journal.path} is written again, from the start of the '
                           'session')

    def save(self, session: Session) -> str:
        """Write the session to ``session.path``; return what was written and what is kept."""
        path = session_path(session.config.session.path)
        points, kept = self._file.save(path, session.to_dict)
        return f'session with {format_count(points, "point")} saved to {path}' + (
            f'; the session that was there before is kept as {kept}' if kept else '')

    def save_tip(self, session: Session, found: FixedPoint) -> str:
        """
        Write a calibrated tip beside ``session.path``, for the next start.

        Return where it is, or why it could not be written, as the end of a sentence.
        """
        assert found.point is not None and found.covariance is not None
        path = tip_path(session_path(session.config.session.path))
        try:
            kept = write_tip(path, found.point, found.covariance[:3, :3], found.message,
                             '~/calibrate_tip')
        except InputError as error:
            return f', but not written: {error.message}'
        return f' and written to {path}' + (
            f'; the tip that was there before is kept as {kept}' if kept else '')

    def load(self, session: Session) -> Path:
        """Restore the session in ``session.path``; return the path of the file."""
        path = session_path(session.config.session.path)
        limit = max(MAX_SIZE, ROW_SIZE * session.config.collect.max_points)
        self._file.load(path, limit, session.restore)
        return path


def _resume(session: Session, path: Path) -> tuple[bool, str]:
    """Load the session from its journal; return whether there is one, and what was found."""
    replay = Replay()
    damage = read_journal(path, replay.apply)
    if damage is None:
        return False, f'there is no journal {path} to resume'
    if session.status().state == 'no_model':
        raise InputError(f'there is no bone model; {path} is kept')
    try:
        session.restore(replay.session)
    except InputError as error:
        raise InputError(f'{error.message}; {path} {_kept(path)}') from None
    if damage:
        damage = f'; {damage}; the whole journal {_kept(path)}'
    session.collect(bool(replay.session['collecting']))
    status = session.status()
    accepted = '' if status.pose_result is None else ', with the accepted registration'
    return True, (f'resumed from {path}: {format_count(status.kept, "point")} in '
                  f'{format_count(status.strokes, "stroke")}, '
                  f'{format_count(status.landmarks, "landmark")}{accepted}{damage}')


def _kept(path: Path) -> str:
    """Set a journal aside; return where it is, as the end of a sentence."""
    try:
        return f'is kept as {set_aside(path)}'
    except OSError as error:
        return f'cannot be renamed: {error.strerror}'


def _retired(journal: SessionJournal) -> str:
    """End a journal and set it aside, so that it is not resumed by mistake; return where it is."""
    try:
        aside = journal.retire()
    except OSError as error:
        return f'; the former one stays at {journal.path}: {error.strerror}'
    return f'; the former one is kept as {aside}' if aside else ''
