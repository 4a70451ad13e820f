# SPDX-License-Identifier: Apache-2.0
"""A journal contains every event, whenever it ends and whatever is wrong with the disk."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gsdf_registration.common.result import InputError
from gsdf_registration.session.events import Replay
from msg_adapters import session_journal
from msg_adapters.session_journal import SessionJournal, journal_path, read_journal

POINT = [1, 0, 1700000000.0125, 0.1, -0.2, 1e-05]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return journal_path(tmp_path / 's.json')


@pytest.fixture
def failures() -> list[str]:
    return []


@pytest.fixture
def journal(path: Path, failures: list[str]) -> Iterator[SessionJournal]:
    made = SessionJournal(path, failures.append)
    made('model', 'abc')
    made('collecting', True)
    yield made
    made.close()
    assert failures == []


def session_of(path: Path) -> tuple[dict[str, Any], str | None]:
    """Return the session that a journal leads to, and what is damaged."""
    replay = Replay()
    damage = read_journal(path, replay.apply)
    return replay.session, damage


def points(path: Path) -> int:
    """Return the number of points in an undamaged journal."""
    session, damage = session_of(path)
    assert damage == ''
    return len(session['points'])


def send(journal: SessionJournal, count: int = 1, first: int = 0) -> None:
    for i in range(first, first + count):
        journal('point', [1, 0, float(i), 0.1 * i, 0.0, 0.0])


def test_an_idle_session_leaves_no_file(journal: SessionJournal, path: Path) -> None:
    for event, value in (('source', '/probe/tip'), ('rejected', {'not_collecting': 1}),
                         ('collecting', False), ('clear', None)):
        journal(event, value)
    assert os.listdir(path.parent) == []
    assert read_journal(path, print) is None


def test_a_closed_journal_ignores_events(journal: SessionJournal, path: Path) -> None:
    send(journal, 2)
    journal.close()
    send(journal, 3)
    journal('clear', None)
    journal('session', {'points': []})
    assert points(path) == 2 and os.listdir(path.parent) == [path.name]


def test_events_reproduce_the_session(journal: SessionJournal, path: Path) -> None:
    journal('source', '/probe/tip')
    journal('frame', 'tracker')
    journal('rejected', {'not_finite': 2})
    journal('point', POINT)
    journal('rejected', {'not_finite': 1})
    journal('rejected', {'too_fast': 1})
    send(journal, 2)
    journal('rejected', {'stale': 1})
    journal.close()
    session, damage = session_of(path)
    assert damage == ''
    assert session['model_sha256'] == 'abc' and session['collecting'] is True
    assert session['sources'] == ['/probe/tip'] and session['frames']['points'] == 'tracker'
    assert session['rejected'] == {'not_finite': 3, 'too_fast': 1, 'stale': 1}
    assert session['points'][0] == [*POINT, None, None] and len(session['points']) == 3


def test_each_line_is_an_event(journal: SessionJournal, path: Path) -> None:
    journal('point', POINT)
    head, *events = [json.loads(line) for line in path.read_text().splitlines()]
    assert head['schema'] == 'gsdf-journal/1' and {'version', 'begun'} < head.keys()
    assert events == [['model', 'abc'], ['collecting', True], ['point', POINT]]


def test_nothing_is_lost_when_the_process_is_killed(path: Path) -> None:
    child = os.fork()
    if child == 0:
        journal = SessionJournal(path, print)
        send(journal, 500)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert points(path) == 500


def test_ignores_an_incomplete_last_line(journal: SessionJournal, path: Path) -> None:
    send(journal, 3)
    journal.close()
    whole = path.read_bytes()
    last = whole.rstrip(b'\n').rindex(b'\n') + 1
    for end in range(last, len(whole) + 1):
        path.write_bytes(whole[:end])
        assert points(path) == (3 if end == len(whole) else 2)


def test_reads_up_to_a_damaged_line(journal: SessionJournal, path: Path) -> None:
    send(journal, 9)
    journal.close()
    lines = path.read_bytes().split(b'\n')
    for damaged in (b'\0\0\0\0', b'{"point": 1}', b'["point", [1]]', b'["magic", 1]', b'\xff'):
        path.write_bytes(b'\n'.join([*lines[:8], damaged, *lines[9:]]))
        session, damage = session_of(path)
        assert len(session['points']) == 5
        assert damage == f'line 9 of {path} is damaged; what follows is ignored'


@pytest.mark.parametrize('content', [b'', b'{', b'\n', b'[]\n', b'{"schema": "gsdf-session/2"}\n'])
def test_rejects_other_files(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(InputError, match='not a journal'):
        read_journal(path, print)


def test_keeps_the_last_two_journals(path: Path, tmp_path: Path) -> None:
    for count in (1, 2, 3, 4):
        journal = SessionJournal(path, pytest.fail)
        assert count == 1 or points(path) == count - 1      # until there is something worth keeping
        send(journal, count)
        journal.close()
    kept = [path, *(path.with_name(f'{path.name}.{number}') for number in (1, 2))]
    assert [points(each) for each in kept] == [4, 3, 2]
    assert len(os.listdir(tmp_path)) == 3


def test_sets_the_journal_of_a_cleared_session_aside(journal: SessionJournal,
                                                     path: Path) -> None:
    journal('source', 'tip')
    send(journal, 5)
    journal('collecting', False)
    journal('clear', None)
    assert not path.exists() and points(path.with_name(f'{path.name}.1')) == 5
    journal('clear', None)
    assert points(path.with_name(f'{path.name}.1')) == 5
    journal('source', 'tip')
    send(journal, 2)
    journal.close()
    session, _ = session_of(path)
    assert (session['model_sha256'], session['collecting']) == ('abc', False)
    assert session['sources'] == ['tip'] and len(session['points']) == 2


def test_a_loaded_session_starts_a_new_journal(journal: SessionJournal, path: Path,
                                               ) -> None:
    send(journal, 5)
    saved = {'model_sha256': 'abc', 'points': [[1, 0, 0.5, 0.0, 0.0, 0.0, 1e-4, 1.0]] * 3}
    journal('session', saved)
    send(journal, 4)
    journal.close()
    assert points(path) == 7
    assert points(path.with_name(f'{path.name}.1')) == 5


def test_a_resumed_journal_contains_nothing_twice(path: Path, tmp_path: Path,
                                                  ) -> None:
    for _ in range(3):
        session, damage = session_of(path)
        journal = SessionJournal(path, pytest.fail)
        if damage is not None:
            journal.begin(session)
        journal('model', 'abc')
        send(journal, 2)
        journal.close()
    assert points(path) == 6
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize('fault', ['write', 'short write', 'open'])
def test_a_full_disk_gives_one_warning(path: Path, monkeypatch: pytest.MonkeyPatch,
                                       failures: list[str], fault: str) -> None:
    journal = SessionJournal(path, failures.append)
    if fault != 'open':
        send(journal, 5)

    def full(*_: object) -> int:
        raise OSError(28, 'No space left on device')
    with monkeypatch.context() as patch:
        if fault == 'short write':
            real = os.write
            patch.setattr(session_journal.os, 'write', lambda file, data: real(file, data[:9]))
        else:
            patch.setattr(session_journal.os, fault, full)
        for _ in range(3):
            send(journal, 5)
            journal('registration', None)
            journal('collecting', True)
    assert len(failures) == 1
    assert 'No space left on device; collecting continues' in failures[0]
    assert fault == 'open' or points(path) == 5
    journal('clear', None)      # a new session is a new attempt
    send(journal, 2)
    journal.close()
    assert len(failures) == 1 and points(path) == 2


def test_a_read_only_folder_gives_one_warning_per_session(tmp_path: Path,
                                                          failures: list[str]) -> None:
    journal = SessionJournal(tmp_path / 'none' / 's.journal', failures.append)
    for _ in range(3):
        send(journal, 5)
    journal('session', {'points': []})
    journal.close()
    assert len(failures) == 2 and 'No such file or directory' in failures[0]


def test_two_nodes_cannot_write_the_same_journal(journal: SessionJournal, path: Path,
                                                 failures: list[str]) -> None:
    send(journal, 3)
    with pytest.raises(InputError, match='another node'):
        read_journal(path, print)
    warnings: list[str] = []
    second = SessionJournal(path, warnings.append)
    send(second, 3)
    second('session', {'points': []})       # as after ~/load, which sets the file aside
    second.close()
    assert len(warnings) == 2
    assert all('another node writes it; give each node its own session.path' in text
               for text in warnings)
    send(journal, 3, first=3)
    journal.close()
    assert points(path) == 6 and os.listdir(path.parent) == [path.name]
