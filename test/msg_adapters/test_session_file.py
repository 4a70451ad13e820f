# SPDX-License-Identifier: Apache-2.0
"""Session files: round trip, readable layout, damage, and faults while writing."""

import operator
import os
import signal
from datetime import datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.result import InputError
from msg_adapters import files
from msg_adapters.session_file import read_session, write_session

PLAIN = st.recursive(st.none() | st.booleans() | st.integers(-2**53, 2**53)
                     | st.floats(allow_nan=False, allow_infinity=False)
                     | st.text(max_size=9),
                     lambda inner: st.lists(inner, max_size=5) | st.dictionaries(
                         st.text(max_size=9), inner, max_size=5),
                     max_leaves=10)


@settings(deadline=None, max_examples=40)
@given(st.dictionaries(st.text(max_size=9), PLAIN, max_size=5))
def test_round_trip(tmp_path_factory, session):
    for key in ('schema', 'saved'):
        session.pop(key, None)
    path = tmp_path_factory.mktemp('session') / 's.json'
    write_session(path, session)
    read = read_session(path)
    assert datetime.fromisoformat(read.pop('saved')).tzinfo is not None
    assert read == {'schema': 'gsdf-session/2', **session}


def test_writes_one_point_per_line(tmp_path):
    path = tmp_path / 's.json'
    write_session(path, {'frames': {'points': 'tracker'}, 'landmarks': [], 'rejected': {},
                         'landmark': [{'name': 'x', 'model': [0.1, 0.2, 0.3]}],
                         'points': [[1, 0, 12.5, 0.1, 0.2, 0.3, None, None],
                                    [1, 0, 12.6, 0.1, 0.2, 0.3, 1e-4, 0.98]]})
    assert path.read_text().splitlines()[3:] == [
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
        '  "points": [',
        '    [1, 0, 12.5, 0.1, 0.2, 0.3, null, null],',
        '    [1, 0, 12.6, 0.1, 0.2, 0.3, 0.0001, 0.98]',
        '  ]',
        '}']


@pytest.mark.parametrize('content, message', [
    (b'', 'is empty'),
    (b'{"schema": "gsdf-session/2", "points": [1, 2', 'not valid JSON'),
    (b'[' * 100_000, 'not valid JSON'),
    (b'\xff\xfe{}', 'not UTF-8'),
    (b'[]', 'not a session'),
    (b'{"schema": "gsdf-session/1"}', 'not a session'),
    (b'{}', 'not a session'),
])
def test_rejects_other_files(tmp_path, content, message):
    path = tmp_path / 's.json'
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_session(path)
    with pytest.raises(InputError, match='does not exist'):
        read_session(tmp_path / 'none.json')


@pytest.mark.parametrize('bad', [float('nan'), float('inf'), object()])
def test_invalid_values_leave_the_old_file(tmp_path, bad):
    path = tmp_path / 's.json'
    write_session(path, {'points': [1]})
    with pytest.raises(InputError, match='cannot be written'):
        write_session(path, {'points': [bad]})
    assert read_session(path)['points'] == [1]
    assert os.listdir(tmp_path) == ['s.json']


STEPS = ['tempfile.mkstemp', 'os.fdopen', 'os.fsync', 'os.chmod', 'os.replace']


@pytest.mark.parametrize('step', STEPS)
def test_an_error_while_writing_leaves_the_old_file(tmp_path, monkeypatch, step):
    path = tmp_path / 's.json'
    write_session(path, {'points': [1]})

    def full(*_, **__):
        raise OSError(28, 'No space left on device')
    with monkeypatch.context() as patch:
        patch.setattr(files, step.split('.')[0], Faulty(step, full))
        with pytest.raises(InputError, match='No space left'):
            write_session(path, {'points': [2]})
    assert read_session(path)['points'] == [1]
    assert os.listdir(tmp_path) == ['s.json']


@pytest.mark.parametrize('step', STEPS)
@pytest.mark.parametrize('when', ['before', 'after'])
def test_a_crash_leaves_the_old_or_the_new_file(tmp_path, monkeypatch, step, when):
    path = tmp_path / 's.json'
    write_session(path, {'points': [1]})
    real = operator.attrgetter(step)(files)

    def killed(*given, **more):
        if when == 'after':
            real(*given, **more)
        os.kill(os.getpid(), signal.SIGKILL)
    monkeypatch.setattr(files, step.split('.')[0], Faulty(step, killed))
    child = os.fork()
    if child == 0:
        write_session(path, {'points': [2]})
        os._exit(0)     # not reached
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    replaced = (step, when) == ('os.replace', 'after')
    assert read_session(path)['points'] == [2 if replaced else 1]


class Faulty:
    """A module with one function replaced."""

    def __init__(self, step, function):
        self._module, self._name = getattr(files, step.split('.')[0]), step.split('.')[1]
        self._function = function

    def __getattr__(self, name):
        return self._function if name == self._name else getattr(self._module, name)


def test_reports_a_folder_that_does_not_exist(tmp_path):
    with pytest.raises(InputError, match='cannot be written'):
        write_session(tmp_path / 'none' / 's.json', {})
