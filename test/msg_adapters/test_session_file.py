# SPDX-License-Identifier: Apache-2.0
"""Session files: round trip, readable layout, damage, faults while writing, and what is kept."""

from __future__ import annotations

import json
import operator
import os
import signal
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.result import InputError
from msg_adapters import files, point_lines, session_file
from msg_adapters.session_file import (
    SessionFile,
    identity,
    read_session,
    session_path,
    write_session,
)

PLAIN = st.recursive(st.none() | st.booleans() | st.integers(-2**53, 2**53)
                     | st.floats(allow_nan=False, allow_infinity=False)
                     | st.text(max_size=9),
                     lambda inner: st.lists(inner, max_size=5) | st.dictionaries(
                         st.text(max_size=9), inner, max_size=5),
                     max_leaves=10)
ROW = np.dtype([('stroke', '<i4'), ('source', '<i4'), ('stamp', '<f8'), ('x', '<f8'), ('y', '<f8'),
                ('z', '<f8'), ('residual', '<f8'), ('weight', '<f8')])
ROWS = st.lists(st.tuples(*2 * [st.integers(0, 9)], *6 * [st.floats(-1e9, 1e9) | st.just(np.nan)]),
                max_size=5).map(lambda rows: np.array(rows, ROW))
RECORD = {'frames': {'points': 'tracker'}, 'landmarks': [], 'rejected': {},
          'landmark': [{'name': 'x', 'model': [0.1, 0.2, 0.3]}],
          'points': np.array([(1, 0, 12.5, 0.1, 0.2, 0.3, np.nan, np.nan),
                              (1, 0, 12.6, 0.1, 0.2, 0.3, 1e-4, 0.98)], ROW)}


def session_with(*stamps: float) -> dict[str, Any]:
    """Return a session record with a point at each of these times."""
    points = np.zeros(len(stamps), ROW)
    points['stamp'] = stamps
    return {'points': points}


def stamps_in(path: Path) -> list[float]:
    """Return the times of the points in a session file."""
    found: list[float] = read_session(path)['points']['stamp'].tolist()
    return found


@settings(deadline=None, max_examples=40)
@given(st.dictionaries(st.text(max_size=9), PLAIN, max_size=5), ROWS)
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, session: dict[str, Any],
                    rows: np.ndarray) -> None:
    for key in ('schema', 'saved', 'sha256', 'points', 'columns'):
        session.pop(key, None)
    path = tmp_path_factory.mktemp('session') / 's.json'
    write_session(path, {'points': rows} | session)
    read = read_session(path)
    points = read.pop('points')
    for name in rows.dtype.names:
        np.testing.assert_array_equal(points[name], rows[name])
    assert datetime.fromisoformat(read.pop('saved')).tzinfo is not None
    assert read == {'schema': 'gsdf-session/3', **session}
    assert json.loads(path.read_text()).keys() - read.keys() == {
        'saved', 'sha256', 'columns', 'points'}


@pytest.mark.parametrize('count', [0, 1, point_lines.PART, 2 * point_lines.PART + 3])
def test_writes_and_reads_points_in_parts(tmp_path: Path, count: int) -> None:
    stamps = [0.5 * i for i in range(count)]
    write_session(tmp_path / 's.json', session_with(*stamps))
    assert stamps_in(tmp_path / 's.json') == stamps
    assert [row[2] for row in json.loads((tmp_path / 's.json').read_text())['points']] == stamps


def test_writes_one_point_per_line(tmp_path: Path) -> None:
    path = tmp_path / 's.json'
    write_session(path, RECORD)
    *lines, checksum, end = path.read_text().splitlines()[3:]
    assert lines == [
        '  "frames": {',
        '    "points": "tracker"',
        '  },',
        '  "landmarks": [],',
        '  "rejected": {},',
        '  "landmark": [',
        '    {',
        '      "name": "x",',
        '      "model": [0.1, 0.2, 0.3]',
        '    }',
        '  ],',
        '  "columns": ["stroke", "source", "stamp", "x", "y", "z", "residual", "weight"],',
        '  "points": [',
        '    [1, 0, 12.5, 0.1, 0.2, 0.3, null, null],',
        '    [1, 0, 12.6, 0.1, 0.2, 0.3, 0.0001, 0.98]',
        '  ],']
    assert checksum.startswith('  "sha256": "') and end == '}'


def test_a_changed_byte_is_never_read(tmp_path: Path) -> None:
    path = tmp_path / 's.json'
    write_session(path, RECORD)
    saved = path.read_bytes()
    for place in range(len(saved)):
        for bit in (0, 4):
            path.write_bytes(saved[:place] + bytes([saved[place] ^ 1 << bit]) + saved[place + 1:])
            with pytest.raises(InputError, match='damaged|is not a session'):
                read_session(path)


def test_a_file_that_is_cut_short_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / 's.json'
    write_session(path, RECORD)
    saved = path.read_bytes()
    for end in range(len(saved)):
        path.write_bytes(saved[:end])
        with pytest.raises(InputError, match='damaged|is not a session|is empty'):
            read_session(path)


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_a_changed_part_is_never_read(tmp_path_factory: pytest.TempPathFactory,
                                      data: st.DataObject) -> None:
    path = tmp_path_factory.mktemp('session') / 's.json'
    write_session(path, RECORD)
    saved = path.read_bytes()
    begin = data.draw(st.integers(0, len(saved) - 1))
    end = data.draw(st.integers(begin, len(saved)))
    other = data.draw(st.binary(max_size=20) | st.just(b'\0' * (end - begin))
                      | st.just(saved[begin:end] * 2))
    path.write_bytes(saved[:begin] + other + saved[end:])
    if path.read_bytes() != saved:
        with pytest.raises(InputError):
            read_session(path)


@pytest.mark.parametrize('content, message', [
    (b'', 'is empty'),
    (b'{"schema": "gsdf-session/3", "points": [1, 2', 'damaged'),
    (b'[' * 100_000, 'not a session'),
    (b'\xff\xfe{}', 'not a session'),
    (b'[]', 'not a session'),
    (b'{"schema": "gsdf-session/2"}', 'of an earlier one without a checksum'),
    (b'{}', 'not a session'),
])
def test_rejects_other_files(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / 's.json'
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_session(path)
    with pytest.raises(InputError, match='does not exist'):
        read_session(tmp_path / 'none.json')


def test_reads_no_device_no_pipe_and_no_huge_file(tmp_path: Path) -> None:
    path = tmp_path / 's.json'
    os.mkfifo(path)     # reading it would wait for ever
    with pytest.raises(InputError, match='is a FIFO'):
        read_session(path)
    with pytest.raises(InputError, match='is a device'):
        read_session('/dev/zero')
    with pytest.raises(InputError, match='is a directory'):
        read_session(tmp_path)
    huge = tmp_path / 'huge.json'
    with huge.open('wb') as file:
        file.truncate(session_file.MAX_SIZE + 1)    # a hole: takes no room
    with pytest.raises(InputError, match='is too large: 256 MB, of at most 256 MB'):
        read_session(huge)


@pytest.mark.parametrize('bad', [float('nan'), float('inf'), object()])
def test_invalid_values_leave_the_old_file(tmp_path: Path, bad: object) -> None:
    path = tmp_path / 's.json'
    write_session(path, session_with(1.0))
    with pytest.raises(InputError, match='cannot be written'):
        write_session(path, session_with(2.0) | {'landmarks': [bad]})
    with pytest.raises(InputError, match='cannot be written: column stamp contains an infinite'):
        write_session(path, session_with(2.0, np.inf))
    assert stamps_in(path) == [1.0]
    assert os.listdir(tmp_path) == ['s.json']


STEPS = ['tempfile.mkstemp', 'os.fdopen', 'os.fsync', 'os.chmod', 'os.replace']


@pytest.mark.parametrize('step', STEPS)
def test_an_error_while_writing_leaves_the_old_file(tmp_path: Path, step: str,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 's.json'
    write_session(path, session_with(1.0))

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, 'No space left on device')
    with monkeypatch.context() as patch:
        patch.setattr(files, step.split('.')[0], Faulty(step, full))
        with pytest.raises(InputError, match='No space left'):
            write_session(path, session_with(2.0), identity(path))
    assert stamps_in(path) == [1]
    assert os.listdir(tmp_path) == ['s.json']


@pytest.mark.parametrize('step', STEPS)
@pytest.mark.parametrize('when', ['before', 'after'])
def test_a_crash_leaves_the_old_or_the_new_file(tmp_path: Path, step: str, when: str,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 's.json'
    write_session(path, session_with(1.0))
    real = operator.attrgetter(step)(files)

    def killed(*given: Any, **more: Any) -> None:
        if when == 'after':
            real(*given, **more)
        os.kill(os.getpid(), signal.SIGKILL)
    monkeypatch.setattr(files, step.split('.')[0], Faulty(step, killed))
    child = os.fork()
    if child == 0:
        write_session(path, session_with(2.0))
        os._exit(0)     # not reached
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    replaced = (step, when) == ('os.replace', 'after')
    assert stamps_in(path) == [2 if replaced else 1]


class Faulty:
    """A module with one function replaced."""

    def __init__(self, step: str, function: Callable[..., None]) -> None:
        self._module, self._name = getattr(files, step.split('.')[0]), step.split('.')[1]
        self._function = function

    def __getattr__(self, name: str) -> Any:
        return self._function if name == self._name else getattr(self._module, name)


def test_reports_a_folder_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='cannot be written'):
        write_session(tmp_path / 'none' / 's.json', RECORD)


@pytest.mark.parametrize('content', [
    b'{"targets": [1.0]}', b'', b'\0' * 9, b'{"schema": "gsdf-journal/2"}', b'x' * 1000])
def test_overwrites_nothing_that_is_not_a_session(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / 'config.json'
    path.write_bytes(content)
    with pytest.raises(InputError, match='is no session file, so it is not overwritten'):
        write_session(path, RECORD, identity(path))
    assert path.read_bytes() == content and os.listdir(tmp_path) == ['config.json']


def test_overwrites_no_link_pipe_or_folder(tmp_path: Path) -> None:
    target = tmp_path / 'target.json'
    write_session(target, session_with(1.0))
    (tmp_path / 'link.json').symlink_to(target)
    (tmp_path / 'broken.json').symlink_to(tmp_path / 'none')
    os.mkfifo(tmp_path / 'fifo.json')
    (tmp_path / 'folder.json').mkdir()
    for name, what in {'link': 'a symbolic link', 'broken': 'a symbolic link', 'fifo': 'a FIFO',
                       'folder': 'a directory'}.items():
        with pytest.raises(InputError, match=f'{name}.json is {what}, so it is not overwritten'):
            write_session(tmp_path / f'{name}.json', RECORD)
    assert stamps_in(target) == [1] and (tmp_path / 'link.json').is_symlink()
    assert len(os.listdir(tmp_path)) == 5


def test_keeps_another_session_under_a_name_with_its_date(tmp_path: Path) -> None:
    path, kept = tmp_path / 's.json', []
    for number in range(4):
        found = write_session(path, session_with(number))
        os.utime(path, (1.7e9, 1.7e9))
        kept.append(found)
    names = [None if each is None else each.name for each in kept]
    assert names == [None, 's.2023-11-14T22-13-20Z.json', 's.2023-11-14T22-13-20Z-2.json',
                     's.2023-11-14T22-13-20Z-3.json']
    assert [stamps_in(each) for each in kept[1:] if each] == [[0.0], [1.0], [2.0]]
    assert stamps_in(path) == [3.0]


def test_keeps_another_session_without_hard_links(tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    def no_link(*_: Any) -> None:
        raise OSError(1, 'Operation not permitted')
    monkeypatch.setattr(os, 'link', no_link)
    path, kept = tmp_path / 's.json', set()
    for number in range(3):
        kept.add(write_session(path, session_with(number)))
        os.utime(path, (1.7e9, 1.7e9))
    assert len(kept) == 3 and stamps_in(path) == [2.0]
    assert sorted(stamps_in(each) for each in kept if each) == [[0.0], [1.0]]


def test_keeps_the_permissions_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / 's.json'
    write_session(path, session_with(1.0))
    assert path.stat().st_mode & 0o777 == 0o644
    path.chmod(0o600)
    write_session(path, session_with(2.0), identity(path))
    assert path.stat().st_mode & 0o777 == 0o600


def record(*points: int) -> Callable[[], dict[str, Any]]:
    return lambda: session_with(*points)


def test_saves_over_what_this_session_saved_or_loaded(tmp_path: Path) -> None:
    path, mine = tmp_path / 's.json', SessionFile()
    mine('model', 'abc')
    assert mine.save(path, record(1)) == (1, None)
    assert mine.save(path, record(1, 2)) == (2, None)
    restarted = SessionFile()
    points, kept = restarted.save(path, record(1, 2, 3))
    assert points == 3 and kept is not None and stamps_in(kept) == [1, 2]
    loaded: list[Any] = []
    again = SessionFile()
    again.load(path, 10**6, loaded.append)
    assert loaded[0]['points']['stamp'].tolist() == [1.0, 2.0, 3.0]
    assert again.save(path, record(1)) == (1, None)
    assert mine.save(path, record(7))[1] is not None        # another node has saved meanwhile


@pytest.mark.parametrize('event, value', [('clear', None), ('clear', 'the clock went back'),
                                          ('session', {}), ('model', 'def')])
def test_keeps_the_session_before_a_new_one(tmp_path: Path, event: str, value: object) -> None:
    path, mine = tmp_path / 's.json', SessionFile()
    mine('model', 'abc')
    mine.save(path, record(1, 2, 3))
    mine('model', 'abc')    # the same bone again
    mine('point', [1, 0, 1.0, 0.0, 0.0, 0.0])
    assert mine.save(path, record(1, 2, 3, 4))[1] is None
    mine(event, value)
    points, kept = mine.save(path, record(1))
    assert points == 1 and kept is not None and stamps_in(kept) == [1, 2, 3, 4]


def test_a_session_that_is_cleared_while_it_is_saved_is_kept(tmp_path: Path) -> None:
    path, mine = tmp_path / 's.json', SessionFile()

    def cleared_meanwhile() -> dict[str, Any]:
        mine('clear', None)
        return session_with(1, 2)
    assert mine.save(path, cleared_meanwhile) == (2, None)
    assert mine.save(path, record(3))[1] is not None


def test_a_session_path_is_absolute_and_ends_with_json(tmp_path: Path,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    assert session_path('s.json') == tmp_path / 's.json'
    assert session_path('a/../s.json') == tmp_path / 's.json'
    assert session_path('~/s.json') == tmp_path / 'home' / 's.json'


@pytest.mark.parametrize('path, message', [
    ('config.yaml', 'ends with .json'), ('/dev/null', 'ends with .json'), ('.json', 'ends with'),
    ('~nosuchuser/s.json', 'this user has no home directory'), ('x' * 300 + '.json', 'longer than'),
    ('s\0.json', 'null')])
def test_rejects_other_session_paths(path: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        write_session(session_path(path), RECORD)
    assert '\n' not in caught.value.message


def test_a_path_of_any_length_is_one_sentence(tmp_path: Path) -> None:
    for path in (tmp_path / ('x' * 5000) / 's.json', tmp_path.joinpath(*['x' * 99] * 60, 's.json')):
        with pytest.raises(InputError, match='name too long'):
            read_session(path)
        with pytest.raises(InputError, match='cannot be written: File name too long'):
            write_session(path, RECORD)
