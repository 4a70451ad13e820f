# SPDX-License-Identifier: Apache-2.0
"""The journal of the node's session: taken up at the start if that is wanted, then written."""

from __future__ import annotations

import os
from pathlib import Path

from rclpy.impl.rcutils_logger import RcutilsLogger

from gsdf_registration.common.config import SessionConfig
from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import InputError
from gsdf_registration.session import Session
from msg_adapters.session_journal import SessionJournal, journal_path, read_journal, set_aside

NO_JOURNAL = SessionJournal(Path(), lambda complaint: None)     # of a node without a session


def keep_journal(session: Session, config: SessionConfig, log: RcutilsLogger) -> SessionJournal:
    """
    Write from now on what happens to ``session``; close what is returned when it ends.

    If ``session.resume``, the session first takes up what the journal beside ``session.path``
    holds.  That, or why it cannot, is said in the log and in the status.
    """
    journal = SessionJournal(journal_path(config.path), log.warning)
    if config.resume:
        try:
            words = _resumed(session, journal)
            log.info(words)
        except InputError as error:
            words = f'nothing is resumed: {error.message}'
            log.error(words)
        session.remark(words)
    session.listen(journal)
    return journal


def check_path(config: SessionConfig, before: SessionConfig) -> None:
    """Raise `InputError` if ``session.path`` changes to where nothing can be written."""
    folder = journal_path(config.path).parent
    if config.path != before.path and not os.access(folder, os.W_OK):
        raise InputError(f'session.path {config.path}: there is no folder {folder} to write to; '
                         f'{before.path} is kept')


def follow(session: Session, journal: SessionJournal, config: SessionConfig,
           log: RcutilsLogger) -> SessionJournal:
    """Keep the journal beside ``session.path`` as it is now, with all that was in it before."""
    path = journal_path(config.path)
    if path == journal.path or journal is NO_JOURNAL:
        return journal
    moved = SessionJournal(path, log.warning)
    session.listen(moved, from_start=True)
    journal.close()
    # what it held is no longer the newest: nobody is to take it up unawares
    aside = set_aside(journal.path) if path.exists() else None
    log.info(f'the journal is {path} from now on' + (f', that of before {aside}' if aside else ''))
    return moved


def _resumed(session: Session, journal: SessionJournal) -> str:
    """Take up the journal, and return what was found in it."""
    path = journal.path
    found = read_journal(path)
    if found is None:
        return f'there is no journal {path} to resume'
    record, damage = found
    if session.status().state == 'no_model':
        raise InputError(f'there is no bone model; {path} is kept')
    try:
        session.restore(record)
    except InputError as error:
        raise InputError(f'{error.message}; {path} is kept as {set_aside(path)}') from None
    if damage:
        damage = f'; {damage}, all of it is kept as {set_aside(path)}'
    session.collect(bool(record['collecting']))
    journal.begin(session.to_dict())
    status = session.status()
    pose = '' if status.pose_result is None else ', with its registration'
    return (f'resumed from {path}: {counted(status.kept, "point")} in '
            f'{counted(status.strokes, "stroke")}, {counted(status.landmarks, "landmark")}{pose}'
            + damage)
