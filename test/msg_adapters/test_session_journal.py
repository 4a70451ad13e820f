# SPDX-License-Identifier: Apache-2.0
"""A journal contains every event, whatever happens to the process, the disk and the file."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.result import InputError
from gsdf_registration.session.events import Replay
from gsdf_registration.session.record import ROW, empty_record
from msg_adapters import session_journal
from msg_adapters.packed_rows import packed
from msg_adapters.session_journal import SessionJournal, journal_path, read_journal

POINT = [1, 0, 1700000000.0125, 0.1, -0.2, 1e-05]
SAVED = empty_record('abc') | {
    'sources': ['tip'], 'points': np.ones(3, ROW)}


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
    journal('session', SAVED)
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
    assert list(session['points'][0])[:len(POINT)] == POINT and len(session['points']) == 3


def test_each_line_is_an_event(journal: SessionJournal, path: Path) -> None:
    journal('point', POINT)
    head, *events = [json.loads(line) for line in path.read_text().splitlines()]
    assert head['schema'] == 'gsdf-journal/3' and {'version', 'begun'} < head.keys()
    assert [event[:2] for event in events] == [
        ['model', 'abc'], ['collecting', True], ['point', POINT]]
    assert all(len(event) == 3 and len(event[2]) == 8 for event in events)


def test_nothing_is_lost_when_the_process_is_killed(path: Path) -> None:
    child = os.fork()
    if child == 0:
        journal = SessionJournal(path, print)
        send(journal, 500)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert points(path) == 500


def whole_journal(path: Path) -> tuple[bytes, list[str]]:
    """Write a journal with every kind of event; return its content and its events."""
    journal = SessionJournal(path, pytest.fail)
    for event, value in [
            ('session', SAVED), ('collecting', False), ('source', 'second tip'), ('point', POINT),
            ('rejected', {'stale': 3}), ('landmark', {'name': 'x', 'stamp': 1.5}), ('undo', 1),
            ('point', [2, 1, 1.7e9, -0.3, 0.2, 0.1]), ('withdrawn', [0, 1.7e9]),
            ('registration', {'result': {'sigma_m': 2e-4}, 'fit': None}),
            ('verification', {'distance_m': -1e-4}), ('pose_withdrawn', 'array_displaced')]:
        journal(event, value)
    journal.close()
    events, damage = events_of(path)
    assert damage == ''
    return path.read_bytes(), events


def events_of(path: Path) -> tuple[list[str], str | None]:
    """Return the events of a journal as JSON, and what is damaged."""
    events: list[str] = []
    damage = read_journal(
        path, lambda *event: events.append(json.dumps(event, default=packed)))
    return events, damage


def check_prefix(path: Path, content: bytes, whole: list[str], cut: bool = False) -> None:
    """Check that of a damaged journal the first events are read, with a note, or none."""
    path.write_bytes(content)
    try:
        read, damage = events_of(path)
    except InputError as error:
        assert 'is not a journal' in error.message or 'is empty' in error.message
        return
    assert read == whole[:len(read)]
    if len(read) < len(whole) and not (cut and content.endswith(b'\n')):
        assert (damage or '').startswith(f'line {len(read) + 2} of {path} is damaged')


def test_a_changed_byte_changes_no_event_and_costs_none_before_it(path: Path) -> None:
    whole, events = whole_journal(path)
    begins = [0, *(i + 1 for i, byte in enumerate(whole) if byte == ord('\n'))]
    assert len(events) == len(begins) - 2 >= 14
    for place in range(len(whole)):
        line = sum(begin <= place for begin in begins)      # from 1; line 1 is the head
        for change in (1, 16, 128):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ change]) + whole[place + 1:])
            try:
                read, damage = events_of(path)
            except InputError as error:
                assert line == 1 and 'is not a journal' in error.message
                assert place == begins[1] - 1       # the end of the first line
                continue
            if line == 1:
                assert read == events
                assert damage in ('', f'line 1 of {path} is damaged')
            else:
                assert read == events[:line - 2]
                assert damage is not None and damage.startswith(f'line {line} of {path} is damaged')


def test_a_journal_that_is_cut_short_has_its_first_events(path: Path) -> None:
    whole, events = whole_journal(path)
    for end in range(len(whole)):
        check_prefix(path, whole[:end], events, cut=True)


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_a_changed_part_changes_no_event(tmp_path_factory: pytest.TempPathFactory,
                                         data: st.DataObject) -> None:
    path = journal_path(tmp_path_factory.mktemp('journal') / 's.json')
    whole, events = whole_journal(path)
    begin = data.draw(st.integers(0, len(whole) - 1))
    end = data.draw(st.integers(begin, len(whole)))
    other = data.draw(st.binary(max_size=20) | st.just(b'\0' * (end - begin))
                      | st.just(whole[begin:end] * 2))
    path.write_bytes(whole[:begin] + other + whole[end:])
    with contextlib.suppress(InputError):
        read, _ = events_of(path)
        assert read == events[:len(read)]


def test_a_missing_or_moved_line_is_found(path: Path) -> None:
    whole, events = whole_journal(path)
    lines = whole.splitlines(keepends=True)
    for missing in range(2, len(lines) - 1):
        check_prefix(path, b''.join(lines[:missing] + lines[missing + 1:]), events)
        swapped = [*lines[:missing], lines[missing + 1], lines[missing], *lines[missing + 2:]]
        check_prefix(path, b''.join(swapped), events)
        check_prefix(path, b''.join([*lines[:missing], lines[missing - 1], *lines[missing:]]),
                     events)


def test_an_incomplete_last_line_is_not_read(journal: SessionJournal, path: Path) -> None:
    send(journal, 3)
    journal.close()
    whole = path.read_bytes()
    last = whole.rstrip(b'\n').rindex(b'\n') + 1
    for end in range(last, len(whole) + 1):
        path.write_bytes(whole[:end])
        session, damage = session_of(path)
        assert len(session['points']) == (3 if end == len(whole) else 2)
        assert damage == ('' if end in (last, len(whole)) else f'line 6 of {path} is damaged')


def test_reads_up_to_a_damaged_line(journal: SessionJournal, path: Path) -> None:
    send(journal, 9)
    journal.close()
    lines = path.read_bytes().split(b'\n')
    for damaged in (b'\0\0\0\0', b'{"point": 1}', b'["point", [1]]', b'["magic", 1]', b'\xff',
                    lines[8].replace(b'0.5', b'0.6')):
        path.write_bytes(b'\n'.join([*lines[:8], damaged, *lines[9:]]))
        session, damage = session_of(path)
        assert len(session['points']) == 5
        assert damage == f'line 9 of {path} is damaged; 3 lines after it ignored'


@pytest.mark.parametrize('content', [b'', b'{', b'\n', b'[]\n', b'{"schema": "gsdf-session/3"}\n',
                                     b'{"schema": "gsdf-journal/1"}\n["model", "abc"]\n',
                                     b'\0' * 5000, b'[' * 5000])
def test_rejects_other_files(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(InputError, match='not a journal|is empty'):
        read_journal(path, print)


def test_reads_and_replaces_no_pipe_link_or_folder(path: Path, failures: list[str]) -> None:
    target = path.with_name('target')
    target.write_text('keep')
    for make, what in ((lambda: os.mkfifo(path), 'a FIFO'), (lambda: path.mkdir(), 'a directory'),
                       (lambda: path.symlink_to(target), 'a symbolic link'),
                       (lambda: path.symlink_to('/dev/zero'), 'a symbolic link')):
        make()
        with pytest.raises(InputError, match=f'{path.name} is {what}'):
            read_journal(path, print)
        journal = SessionJournal(path, failures.append)
        send(journal, 3)
        journal.close()
        assert f'cannot be written: {path.name} is {what}; ' in failures[-1]
        assert sorted(os.listdir(path.parent)) == [path.name, 'target']
        path.rmdir() if path.is_dir() else path.unlink()
    assert target.read_text() == 'keep' and len(failures) == 4


def test_a_journal_that_is_kept_replaces_no_link(path: Path, failures: list[str]) -> None:
    first = path.with_name(f'{path.name}.1')
    first.symlink_to(path.with_name('none'))
    journal = SessionJournal(path, failures.append)
    send(journal, 3)
    journal('clear', None)      # goes on in the same file
    send(journal, 2)
    journal.close()
    assert first.is_symlink() and points(path) == 2 and failures == []
    journal = SessionJournal(path, failures.append)     # of the next run
    send(journal, 1)
    assert first.is_symlink() and points(path) == 2
    assert f'{first.name} is a symbolic link' in journal.problem and len(failures) == 1


def test_reads_no_huge_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with path.open('wb') as file:
        file.truncate(session_journal.MAX_SIZE + 1)     # a hole: takes no room
    with pytest.raises(InputError, match='too large'):
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
    journal('session', SAVED)
    send(journal, 4)
    journal.close()
    assert points(path) == 7
    assert points(path.with_name(f'{path.name}.1')) == 5


def test_a_resumed_journal_contains_nothing_twice(path: Path, tmp_path: Path) -> None:
    for _ in range(3):
        session, damage = session_of(path)
        journal = SessionJournal(path, pytest.fail, continues=damage is not None)
        journal('session', session)
        send(journal, 2)
        journal.close()
    assert points(path) == 6
    assert os.listdir(tmp_path) == [path.name]


def full_disk(*_: object) -> int:
    raise OSError(28, 'No space left on device')


@pytest.mark.parametrize('fault', ['write', 'short write', 'open'])
def test_a_full_disk_gives_one_warning_and_can_be_renewed(
        path: Path, monkeypatch: pytest.MonkeyPatch, failures: list[str], fault: str) -> None:
    journal = SessionJournal(path, failures.append)
    if fault != 'open':
        send(journal, 5)
    assert journal.problem == ''
    with monkeypatch.context() as patch:
        if fault == 'short write':
            real = os.write
            patch.setattr(session_journal.os, 'write', lambda file, data: real(file, data[:9]))
        else:
            patch.setattr(session_journal.os, 'write', full_disk)
        for _ in range(3):
            send(journal, 5)
            journal('registration', None)
            journal('collecting', True)
            journal.renew()
            journal('session', SAVED)
    assert len(failures) == 1
    assert 'No space left on device; points are now lost if the node crashes' in failures[0]
    assert journal.problem == failures[0] and not journal.writing
    assert os.listdir(path.parent) == [] if fault == 'open' else points(path) == 5
    journal.renew()
    journal('session', SAVED)       # there is room again
    send(journal, 2)
    journal.close()
    assert journal.problem == '' and len(failures) == 1 and points(path) == 5
    assert os.listdir(path.parent) == [path.name]


def test_a_journal_that_is_deleted_or_replaced_is_noticed_at_the_next_point(
        path: Path, failures: list[str]) -> None:
    journal = SessionJournal(path, failures.append)
    for change in (path.unlink, lambda: path.rename(path.with_name('away')),
                   lambda: path.with_name('away').replace(path)):
        send(journal)
        change()
        send(journal)
        assert 'it was deleted or replaced' in journal.problem
        journal.renew()
        journal('session', SAVED)
        assert journal.problem == '' and len(path.read_text().splitlines()) == 5
    assert len(failures) == 3
    assert points(path.with_name(f'{path.name}.1')) == 4    # a file of unknown origin is kept


@pytest.mark.parametrize('event, left', [('clear', 0), ('session', 3)])
def test_a_new_session_in_a_read_only_folder_goes_on_in_the_same_file(
        path: Path, monkeypatch: pytest.MonkeyPatch, event: str, left: int) -> None:
    journal = SessionJournal(path, pytest.fail)
    journal('source', 'tip')
    send(journal, 5)
    journal('rejected', {'stale': 2})
    with monkeypatch.context() as patch:
        patch.setattr(session_journal.os, 'replace', full_disk)
        journal(event, None if event == 'clear' else SAVED)
        journal('rejected', {'too_fast': 1})
        send(journal, 2)
        journal('collecting', False)
    journal.close()
    session, damage = session_of(path)
    assert damage == '' and len(session['points']) == left + 2
    assert session['rejected'] == {'too_fast': 1} and session['collecting'] is False
    assert os.listdir(path.parent) == [path.name]


def test_a_clear_that_cannot_be_written_is_made_up_for(
        path: Path, monkeypatch: pytest.MonkeyPatch, failures: list[str]) -> None:
    journal = SessionJournal(path, failures.append)
    send(journal, 5)
    with monkeypatch.context() as patch:
        patch.setattr(session_journal.os, 'replace', full_disk)
        patch.setattr(session_journal.os, 'write', full_disk)
        journal('clear', None)
    assert len(failures) == 1 and points(path) == 5
    journal.renew()
    journal('session', empty_record('abc'))
    assert journal.problem == '' and not path.exists()
    assert points(path.with_name(f'{path.name}.1')) == 5
    send(journal, 2)
    journal.close()
    assert points(path) == 2


def test_a_long_journal_is_renewed(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_journal, 'RENEW_SIZE', 2000)
    journal = SessionJournal(path, pytest.fail)
    journal('session', SAVED)
    for _ in range(40):
        assert not journal.too_long
        journal('registration', None)
    send(journal, 30)
    assert journal.too_long
    journal.renew()
    journal('session', SAVED)
    assert not journal.too_long
    journal.close()
    assert points(path) == 3 and path.stat().st_size < 2000
    assert os.listdir(path.parent) == [path.name]


def test_a_value_that_cannot_be_written_does_not_reach_the_session(
        path: Path, failures: list[str]) -> None:
    journal = SessionJournal(path, failures.append)
    journal('verification', {'distance_m': float('nan')})
    assert len(failures) == 1 and 'not JSON compliant' in failures[0]


def test_a_folder_that_does_not_exist_gives_one_warning(tmp_path: Path,
                                                        failures: list[str]) -> None:
    journal = SessionJournal(tmp_path / 'none' / 's.journal', failures.append)
    for _ in range(3):
        send(journal, 5)
    journal('session', SAVED)
    journal.close()
    assert len(failures) == 1 and 'No such file or directory' in failures[0]


def test_two_nodes_cannot_write_the_same_journal(journal: SessionJournal, path: Path,
                                                 failures: list[str]) -> None:
    send(journal, 3)
    with pytest.raises(InputError, match='another node'):
        read_journal(path, print)
    warnings: list[str] = []
    second = SessionJournal(path, warnings.append)
    send(second, 3)
    second('session', SAVED)       # as after ~/load, which sets the file aside
    second.close()
    assert len(warnings) == 1
    assert 'another node writes it; give each node its own session.path' in warnings[0]
    send(journal, 3, first=3)
    journal.close()
    assert points(path) == 6 and os.listdir(path.parent) == [path.name]


def test_a_retired_journal_is_set_aside_if_it_was_written(journal: SessionJournal,
                                                          path: Path) -> None:
    other = path.with_name('other')
    other.write_text('of an earlier run')
    assert SessionJournal(other, pytest.fail).retire() is None and other.exists()
    send(journal, 3)
    aside = journal.retire()
    assert aside == path.with_name(f'{path.name}.1') and points(aside) == 3
    assert not path.exists()
