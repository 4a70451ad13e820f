# SPDX-License-Identifier: Apache-2.0
"""Paths and files of any kind: each problem is one sentence, and only regular files are written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gsdf_registration.common.result import InputError
from msg_adapters.files import (
    absolute_path,
    irregular,
    open_file,
    read_json,
    read_text,
    readable_file,
    write_atomically,
)


def test_a_path_becomes_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('HOME', '/home/of/somebody')
    assert absolute_path('a/b.txt') == tmp_path / 'a' / 'b.txt'
    assert absolute_path('~/b.txt') == Path('/home/of/somebody/b.txt')
    assert absolute_path(tmp_path) == tmp_path


def test_a_user_without_home_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match='^~nosuchuser/x: this user has no home directory; give'):
        absolute_path('~nosuchuser/x')
    monkeypatch.delenv('HOME', raising=False)
    monkeypatch.setattr(os, 'getuid', lambda: 2**31 - 5)
    with pytest.raises(InputError, match='^~/x: this user has no home directory'):
        absolute_path('~/x')


def test_a_current_directory_that_is_gone_is_one_sentence(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'gone').mkdir()
    monkeypatch.chdir(tmp_path / 'gone')
    (tmp_path / 'gone').rmdir()
    with pytest.raises(InputError, match='No such file'):
        absolute_path('x')
    monkeypatch.chdir(tmp_path)


def make(folder: Path) -> dict[str, Path]:
    """Return one of each kind of thing that is no regular file."""
    paths = {what: folder / f'the {what}' for what in ('directory', 'FIFO', 'symbolic link')}
    paths['directory'].mkdir()
    os.mkfifo(paths['FIFO'])
    (folder / 'target').write_text('target')
    paths['symbolic link'].symlink_to(folder / 'target')
    return paths


def test_tells_regular_files_from_others(tmp_path: Path) -> None:
    for what, path in make(tmp_path).items():
        assert irregular(path) == f'a {what}'
    assert irregular('/dev/null') == 'a device'
    assert irregular(tmp_path / 'target') == irregular(tmp_path / 'none') == ''
    assert irregular(tmp_path / 'target' / 'none') == ''


@pytest.mark.parametrize('read', [readable_file, read_text, lambda path: open_file(path, 100)])
def test_reads_regular_files_only(tmp_path: Path, read) -> None:
    paths = make(tmp_path)
    for what in ('directory', 'FIFO'):
        with pytest.raises(InputError, match=f'is a {what}; choose a '):
            read(paths[what])
    with pytest.raises(InputError, match='is a device'):
        read('/dev/zero')
    for path in (tmp_path / 'none', tmp_path / 'target' / 'none'):
        with pytest.raises(InputError, match='does not exist'):
            read(path)
    for path in ('x' * 300, 'x/' * 5000, 'a\0b'):
        with pytest.raises(InputError, match='cannot be read: (File name too long|embedded null)'):
            read(path)
    with open_file(paths['symbolic link'], 6) as file:
        assert file.read() == b'target'


def test_opens_no_file_beyond_the_limit(tmp_path: Path) -> None:
    (tmp_path / 'file').write_bytes(b'x' * 2_000_001)
    with pytest.raises(InputError, match='is too large: 2 MB, of at most 2 MB'):
        open_file(tmp_path / 'file', 2_000_000)
    with open_file(tmp_path / 'file', 2_000_001) as file:
        assert len(file.read()) == 2_000_001


def test_writes_regular_files_only(tmp_path: Path) -> None:
    for what, path in make(tmp_path).items():
        with pytest.raises(InputError, match=f'is a {what}, which is not replaced; choose'):
            write_atomically(path, 'other')
        assert irregular(path) == f'a {what}'
    assert (tmp_path / 'target').read_text() == 'target'
    for path in ('x' * 300, tmp_path / 'target' / 'file', tmp_path / 'none' / 'file'):
        with pytest.raises(InputError, match='cannot be written: '):
            write_atomically(path, 'other')
    assert len(os.listdir(tmp_path)) == 4
    write_atomically(tmp_path / ('x' * 250), 'a long name')     # longer with a suffix than allowed


def test_calls_back_before_it_replaces_the_file(tmp_path: Path) -> None:
    path, seen = tmp_path / 'file', []
    path.write_text('old')
    write_atomically(path, 'new', before=lambda: seen.append(path.read_text()))
    assert seen == ['old'] and path.read_text() == 'new'

    def refuse() -> None:
        raise InputError('no')
    with pytest.raises(InputError, match='^no$'):
        write_atomically(path, 'newer', before=refuse)
    assert path.read_text() == 'new' and os.listdir(tmp_path) == ['file']


@pytest.mark.parametrize('text, complaint', [
    ('{\n"a": ', ', line 2: this is not valid JSON'),
    ('[' * 100_000, ': this is not valid JSON'), ('9' * 5000, ': this is not valid JSON')])
def test_invalid_json_is_one_sentence(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / 'a.json'
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_json(path)
    assert error.value.message == f'{path}{complaint}'
