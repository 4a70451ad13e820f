# SPDX-License-Identifier: Apache-2.0
"""The journal of the node's session: resumed at the start if ``session.resume``, then written."""

from __future__ import annotations

import os
from pathlib import Path

from rclpy.impl.rcutils_logger import RcutilsLogger

from gsdf_registration.common.config import SessionConfig
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.session import Session
from gsdf_registration.session.events import Replay
from msg_adapters.session_journal import SessionJournal, journal_path, read_journal, set_aside

NO_JOURNAL = SessionJournal(Path(), lambda message: None)       # of a node without a session


def keep_journal(session: Session, config: SessionConfig, log: RcutilsLogger) -> SessionJournal:
    """
    Start to write the events of ``session``; close the journal that is returned at its end.

    If ``session.resume``, the session is first loaded from the journal of ``session.path``.  Log
    and status say whether that worked.
    """
    journal = SessionJournal(journal_path(config.path), log.warning)
    if config.resume:
        try:
            notice = _resume(session, journal)
            log.info(notice)
        except InputError as error:
            notice = f'nothing is resumed: {error.message}'
            log.error(notice)
        session.set_notice(notice)
    session.listen(journal)
    return journal


def check_path(config: SessionConfig, before: SessionConfig) -> None:
    """Raise `InputError` if ``session.path`` changes to a folder that cannot be written."""
    folder = journal_path(config.path).parent
    if config.path != before.path and not os.access(folder, os.W_OK):
        raise InputError(f'session.path {config.path}: the folder {folder} cannot be written; '
                         f'{before.path} is kept')


def move_journal(session: Session, journal: SessionJournal, config: SessionConfig,
                 log: RcutilsLogger) -> SessionJournal:
    """Move the journal, with its content, if ``session.path`` has changed."""
    path = journal_path(config.path)
    if path == journal.path or journal is NO_JOURNAL:
        return journal
    moved = SessionJournal(path, log.warning)
    session.stop_listening(journal)
    session.listen(moved, from_start=True)
    journal.close()
    # the old file is set aside, so that it is not resumed later by mistake
    aside = set_aside(journal.path) if path.exists() else None
    log.info(f'the journal is now {path}' + (f'; the former one is kept as {aside}' if aside
                                             else ''))
    return moved


def _resume(session: Session, journal: SessionJournal) -> str:
    """Load the session from its journal, and return what was found."""
    path, replay = journal.path, Replay()
    damage = read_journal(path, replay.apply)
    if damage is None:
        return f'there is no journal {path} to resume'
    if session.status().state == 'no_model':
        raise InputError(f'there is no bone model; {path} is kept')
    try:
        session.restore(replay.session)
    except InputError as error:
        raise InputError(f'{error.message}; {path} is kept as {set_aside(path)}') from None
    if damage:
        damage = f'; {damage}; the whole journal is kept as {set_aside(path)}'
    session.collect(bool(replay.session['collecting']))
    journal.begin(session.to_dict())
    status = session.status()
    accepted = '' if status.pose_result is None else ', with the accepted registration'
    return (f'resumed from {path}: {format_count(status.kept, "point")} in '
            f'{format_count(status.strokes, "stroke")}, '
            f'{format_count(status.landmarks, "landmark")}{accepted}{damage}')
