# SPDX-License-Identifier: Apache-2.0

import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.result import InputError
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
def test_a_session_comes_back_as_it_was(tmp_path_factory, session):
    session.pop('schema', None)
    path = tmp_path_factory.mktemp('session') / 's.json'
    write_session(path, session)
    assert read_session(path) == {'schema': 'gsdf-session/1', **session}


@pytest.mark.parametrize('content, words', [
    (b'', 'is empty'),
    (b'{"schema": "gsdf-session/1", "points": [1, 2', 'not valid JSON'),
    (b'[' * 100_000, 'not valid JSON'),
    (b'\xff\xfe{}', 'not UTF-8'),
    (b'[]', 'no session'),
    (b'{"schema": "gsdf-session/2"}', 'no session'),
    (b'{}', 'no session'),
])
def test_what_is_no_session_is_said(tmp_path, content, words):
    path = tmp_path / 's.json'
    path.write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_session(path)
    with pytest.raises(InputError, match='does not exist'):
        read_session(tmp_path / 'none.json')


@pytest.mark.parametrize('bad', [float('nan'), float('inf'), object()])
def test_a_session_that_cannot_be_written_leaves_the_old_file(tmp_path, bad):
    path = tmp_path / 's.json'
    write_session(path, {'points': [1]})
    with pytest.raises(InputError, match='cannot be written'):
        write_session(path, {'points': [bad]})
    assert read_session(path)['points'] == [1]
    assert os.listdir(tmp_path) == ['s.json']


def test_a_crash_while_writing_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / 's.json'
    write_session(path, {'points': [1]})

    def full(_):
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr(files.os, 'fsync', full)
    with pytest.raises(InputError, match='No space left'):
        write_session(path, {'points': [2]})
    assert read_session(path)['points'] == [1]
    assert os.listdir(tmp_path) == ['s.json']


def test_a_place_that_does_not_exist_is_said(tmp_path):
    with pytest.raises(InputError, match='cannot be written'):
        write_session(tmp_path / 'none' / 's.json', {})
