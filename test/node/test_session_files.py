# SPDX-License-Identifier: Apache-2.0
"""The files of a session: nothing acknowledged is lost, whatever happens to folders and disks."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_fixtures import CONFIG, bone, registered, sample, send, surface_points

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from gsdf_registration.field import Field
from gsdf_registration.node import session_files
from gsdf_registration.node.session_files import SessionFiles
from gsdf_registration.session import Session
from msg_adapters import session_journal
from msg_adapters.packed_rows import packed
from msg_adapters.session_file import read_session, write_session


class Log:
    """Stands in for the logger of a node."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __getattr__(self, level: str) -> Callable[[str], None]:
        return lambda text: self.lines.append((level, text))

    def of(self, level: str) -> list[str]:
        return [text for each, text in self.lines if each == level]


@pytest.fixture(scope='module')
def field() -> Field:
    return bone()


def config_at(path: Path, resume: bool = False) -> Config:
    return CONFIG.replaced({'session.path': str(path), 'session.resume': resume})


class Node:
    """What a node does with its session and files."""

    def __init__(self, field: Field, path: Path, resume: bool = False,
                 session: Session | None = None) -> None:
        config = config_at(path, resume)
        self.log: Any = Log()
        self.session = session or Session(config, field)
        self.session.configure(config)
        self.files = SessionFiles(self.log)
        self.files.open(self.session, config.session)

    def move(self, path: Path) -> None:
        config = config_at(path)
        self.files.move(config.session)
        self.session.configure(config)

    @property
    def points(self) -> int:
        return self.session.status().kept


def resumed(field: Field, path: Path) -> Node:
    return Node(field, path, resume=True)


def content(session: Session) -> dict[str, Any]:
    """Return what a resumed session has in common with the one before."""
    record = session.to_dict()
    return {key: record[key] for key in (
        'landmarks', 'verifications', 'sources', 'result', 'pose_result', 'collecting',
        'model_sha256')} | {'points': packed(record['points']),
                            'frame': record['frames']['points'] if len(record['points']) else None}


def act(session: Session, what: str, time: float) -> float:
    """Do something; return the time after it."""
    if what in ('point', 'tip 2'):
        for _ in range(3):
            time += 1.0
            session.add(sample(time, (1e-3 * time, 0.0, -1.0), topic=what))
    elif what == 'rejected':
        session.add(sample(0.0, (0.0, 0.0, -1.0)))
    elif what == 'drop':
        session.drop_stroke(1)
    elif what in ('start', 'end'):
        session.collect(what == 'start')
    elif what in ('undo', 'clear', 'register'):
        getattr(session, what)()
    return time


@settings(deadline=None, max_examples=60)
@given(st.lists(st.sampled_from(['point', 'point', 'tip 2', 'rejected', 'start', 'end', 'undo',
                                 'clear', 'drop', 'move', 'move', 'check', 'lost']), max_size=25))
def test_changing_the_path_at_any_moment_loses_nothing(
        field: Field, tmp_path_factory: pytest.TempPathFactory, acts: list[str]) -> None:
    folder, time, moves = tmp_path_factory.mktemp('moves'), 0.0, 0
    node = Node(field, folder / '0.json')
    for what in acts:
        if what == 'move':
            moves += 1
            node.move(folder / f'{moves % 3}.json')
        elif what == 'lost':    # the journal is deleted, and noticed at the next change
            Path(f'{folder / str(moves % 3)}.json.journal').unlink(missing_ok=True)
            node.session.count_rejected({'stale': 1})
            time = act(node.session, 'start', time)
        elif what == 'check':
            node.files._next_try = 0.0
            node.files.check()
        else:
            time = act(node.session, what, time)
    node.files._next_try = 0.0
    node.files.check()
    assert node.files.problem == ''
    node.files._journal.close()     # a killed process leaves no lock
    again = resumed(field, folder / f'{moves % 3}.json')
    if node.points:
        assert content(again.session) == content(node.session)
    else:
        assert again.points == 0


def test_a_moved_journal_starts_with_the_whole_session(field: Field, tmp_path: Path) -> None:
    node = Node(field, tmp_path / 'a.json', session=registered(field))
    before = content(node.session)
    node.move(tmp_path / 'b.json')
    assert sorted(os.listdir(tmp_path)) == ['a.json.journal.1', 'b.json.journal']
    send(node.session, surface_points(field, 7), start=1000.0)
    assert node.points > len(before['points'])
    node.files.close()
    again = resumed(field, tmp_path / 'b.json')
    assert content(again.session) == content(node.session)
    assert again.session.status().message.split('; ')[-1].startswith('resumed from')
    assert again.log.of('info')[0].startswith(f'resumed from {tmp_path}/b.json.journal: ')


def test_a_new_path_that_cannot_be_written_changes_nothing(field: Field, tmp_path: Path) -> None:
    node = Node(field, tmp_path / 'a.json', session=registered(field))
    os.mkfifo(tmp_path / 'fifo.json.journal')
    other = Node(field, tmp_path / 'other.json', session=registered(field))
    assert other.files.problem == ''
    for path, message in ((tmp_path / 'none' / 's.json', 'cannot be written: No such file'),
                          (tmp_path / 'fifo.json', 'fifo.json.journal is a FIFO'),
                          (tmp_path / 'other.json', 'another node writes it'),
                          (Path('/proc/s.json'), 'cannot be written'),
                          (Path('~nosuchuser/s.json'), 'no home directory'),
                          (tmp_path / ('x' * 400), 'ends with .json'),
                          (tmp_path / ('x' * 400) / 's.json', 'File name too long'),
                          (tmp_path / ('x' * 240 + '.json'), 'longer than 200 bytes')):
        with pytest.raises(InputError, match=message) as caught:
            node.files.move(config_at(path).session)
        assert '\n' not in caught.value.message
    send(node.session, surface_points(field, 7), start=1000.0)
    node.files.close()
    assert content(resumed(field, tmp_path / 'a.json').session) == content(node.session)


def test_a_full_disk_at_the_new_path_keeps_the_former(field: Field, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node(field, tmp_path / 'a.json', session=registered(field))
    with monkeypatch.context() as patch:
        patch.setattr(session_journal.os, 'write', no_room)
        with pytest.raises(InputError, match='No space left on device; .*a.json.journal is kept'):
            node.move(tmp_path / 'b.json')
    assert node.files.problem == '' and os.listdir(tmp_path) == ['a.json.journal']
    send(node.session, surface_points(field, 7), start=1000.0)
    node.files.close()
    assert content(resumed(field, tmp_path / 'a.json').session) == content(node.session)


def no_room(*_: object) -> int:
    raise OSError(28, 'No space left on device')


def test_a_former_folder_that_is_gone_does_not_matter(field: Field, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'old').mkdir()
    node = Node(field, tmp_path / 'old' / 's.json', session=registered(field))

    def read_only(*_: object) -> None:
        raise OSError(30, 'Read-only file system')
    with monkeypatch.context() as patch:
        patch.setattr(session_files.SessionJournal, 'retire', read_only)
        node.move(tmp_path / 'a.json')
    assert node.log.of('info')[-1].endswith(
        f'the former one stays at {tmp_path}/old/s.json.journal: Read-only file system')
    (tmp_path / 'gone').mkdir()
    node.move(tmp_path / 'gone' / 's.json')
    shutil.rmtree(tmp_path / 'gone')
    node.move(tmp_path / 'b.json')
    node.files.close()
    assert content(resumed(field, tmp_path / 'b.json').session) == content(node.session)


def test_a_full_disk_is_said_and_made_up_for(field: Field, tmp_path: Path,
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node(field, tmp_path / 's.json')
    clock = [0.0]
    monkeypatch.setattr(session_files.time, 'monotonic', lambda: clock[0])
    send(node.session, surface_points(field, 20))
    with monkeypatch.context() as patch:
        patch.setattr(session_journal.os, 'write', no_room)
        for _ in range(5):
            send(node.session, surface_points(field, 20), start=100.0 + clock[0])
            clock[0] += 30.0
            node.files.check()
    assert node.files.problem == (
        f'the journal {tmp_path}/s.json.journal cannot be written: No space left on device; points '
        'are now lost if the node crashes: make room or change session.path, and save')
    assert node.log.of('warning') == [node.files.problem]       # once
    assert 'saved to' in node.files.save(node.session)          # to another disk, say
    clock[0] += 5.0
    node.files.check()
    assert node.files.problem       # not tried again yet
    clock[0] += 5.0
    node.files.check()
    assert node.files.problem == '' and 'is written again' in node.log.of('info')[-1]
    node.files.close()
    assert content(resumed(field, tmp_path / 's.json').session) == content(node.session)
    assert node.points >= 100


def test_a_deleted_journal_is_written_again(field: Field, tmp_path: Path) -> None:
    node = Node(field, tmp_path / 's.json')
    send(node.session, surface_points(field, 20))
    (tmp_path / 's.json.journal').unlink()
    send(node.session, surface_points(field, 20), start=100.0)
    assert 'it was deleted or replaced' in node.files.problem
    node.files.check()
    assert node.files.problem == ''
    node.files.close()
    assert content(resumed(field, tmp_path / 's.json').session) == content(node.session)


def test_a_second_topic_after_a_resume_keeps_its_points(field: Field, tmp_path: Path) -> None:
    node = Node(field, tmp_path / 's.json')
    act(node.session, 'point', 0.0)
    for turn in range(3):
        node.files.close()
        node = resumed(field, tmp_path / 's.json')
        act(node.session, 'tip 2', 10.0 * turn)
    node.files.close()
    again = resumed(field, tmp_path / 's.json')
    assert again.session.to_dict()['sources'] == ['point', 'tip 2']
    assert content(again.session) == content(node.session) and again.points == 12


def test_one_damaged_record_costs_what_follows_it_only(field: Field, tmp_path: Path) -> None:
    node = Node(field, tmp_path / 's.json', session=registered(field))
    send(node.session, surface_points(field, 10), start=1000.0)
    kept = node.points
    assert node.session.undo().success
    node.files.close()
    journal = tmp_path / 's.json.journal'
    journal.write_bytes(journal.read_bytes().replace(b'["undo"', b'["unda"'))
    again = resumed(field, tmp_path / 's.json')
    assert again.points == kept     # the points that were dropped are there again, and it is said
    notice = again.session.status().notice
    assert notice.endswith(f'of {journal} is damaged; 1 line after it ignored; the whole journal '
                           f'is kept as {journal}.1')


def test_a_damaged_journal_in_a_folder_that_cannot_be_written_is_said(
        field: Field, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node(field, tmp_path / 's.json', session=registered(field))
    send(node.session, surface_points(field, 10), start=1000.0)
    node.files.close()
    journal = tmp_path / 's.json.journal'
    journal.write_bytes(journal.read_bytes()[:-3])

    def read_only(*_: object) -> None:
        raise OSError(30, 'Read-only file system')
    monkeypatch.setattr(os, 'replace', read_only)
    again = resumed(field, tmp_path / 's.json')
    assert again.points == node.points - 1
    assert 'the whole journal cannot be renamed: Read-only file system' in (
        again.session.status().notice)
    assert 'Read-only file system' in again.files.problem
    other = Node(bone(width=0.035), tmp_path / 's.json', resume=True)
    assert 'belongs to another bone model' in other.session.status().notice
    assert other.session.status().warning


@pytest.mark.parametrize('change', [{'predicted_tre_m': {'rms': 'x'}}, {'message': 1.5},
                                    {'covariance': None, 'used': '7'}])
def test_wrong_types_are_not_resumed(field: Field, tmp_path: Path,
                                     change: dict[str, Any]) -> None:
    session = registered(field)
    record = session.to_dict()
    record['pose_result'] |= change
    journal = session_journal.SessionJournal(tmp_path / 's.json.journal', pytest.fail)
    journal('session', record)
    journal.close()
    node = resumed(field, tmp_path / 's.json')
    assert node.log.of('error')[0].startswith('nothing is resumed: the session is damaged: ')
    assert node.points == 0 and node.session.status().warning


def test_save_says_the_path_the_points_and_what_is_kept(
        field: Field, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    node = Node(field, Path('s.json'), session=registered(field))
    path = tmp_path / 's.json'
    assert node.files.save(node.session) == f'session with 300 points saved to {path}'
    assert node.files.save(node.session) == f'session with 300 points saved to {path}'
    node.session.clear()
    send(node.session, surface_points(field, 10), start=1000.0)
    answer = node.files.save(node.session)
    (kept,) = tmp_path.glob('s.*Z.json')
    assert answer == (f'session with 10 points saved to {path}; the session that was there before '
                      f'is kept as {kept}')
    assert len(read_session(kept)['points']) == 300
    assert node.files.load(node.session) == path and node.points == 10
    restarted = Node(field, path, session=registered(field))
    assert 'is kept as' in restarted.files.save(restarted.session)


def test_load_reads_as_many_points_as_may_be_collected(field: Field, tmp_path: Path,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node(field, tmp_path / 's.json', session=registered(field))
    node.files.save(node.session)
    monkeypatch.setattr(session_files, 'MAX_SIZE', 1000)
    assert node.files.load(node.session) == tmp_path / 's.json'
    node.session.configure(node.session.config.replaced({'collect.max_points': 100}))
    with pytest.raises(InputError, match='too large'):
        node.files.load(node.session)


def test_two_nodes_that_save_to_one_file_keep_both_sessions(field: Field, tmp_path: Path) -> None:
    first = Node(field, tmp_path / 's.json', session=registered(field))
    second = Node(field, tmp_path / 's.json')
    send(second.session, surface_points(field, 10))
    assert 'another node writes it' in second.files.problem
    first.files.save(first.session)
    second.files.save(second.session)
    first.files.save(first.session)
    sizes = {len(read_session(each)['points']) for each in tmp_path.glob('*.json')}
    assert len(list(tmp_path.glob('*.json'))) == 3 and sizes == {300, 10}


def test_a_session_of_another_bone_is_not_loaded(field: Field, tmp_path: Path) -> None:
    write_session(tmp_path / 's.json', registered(field).to_dict())
    node = Node(bone(width=0.035), tmp_path / 's.json')
    with pytest.raises(InputError, match='another bone'):
        node.files.load(node.session)
    assert dataclasses.asdict(node.session.config)['session']['path'] == str(tmp_path / 's.json')
