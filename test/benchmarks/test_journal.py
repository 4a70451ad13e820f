# SPDX-License-Identifier: Apache-2.0
"""A table survives interruption, and is not continued with something else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.journal import Journal, source_hash
from gsdf_registration.common.result import InputError

ABOUT = {'seed': 1, 'config': {'search.parts': 3}}
ROW = {'name': 'a\tb "c"\né', 'x': 0.1 + 0.2, 'n': 3, 'ok': True, 'none': None}


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / 'table.tsv'
    journal = Journal(path, ABOUT)
    journal.add('first', ROW)
    journal.add('second', {**ROW, 'x': float('inf')})
    return path


def test_rows_come_back_as_they_were(table: Path) -> None:
    rows = Journal(table, ABOUT).rows
    assert rows['first'] == {'job': 'first', **ROW}
    assert rows['second']['x'] == float('inf')
    lines = table.read_text().splitlines()
    assert json.loads(lines[0].removeprefix('# ')) == ABOUT
    assert lines[1].split('\t') == ['job', *ROW] and len(lines) == 4


def test_every_torn_end_is_cut_off(table: Path) -> None:
    whole = table.read_bytes()
    last = whole.rstrip(b'\n').rfind(b'\n') + 1
    for end in (last, last + 1, len(whole) - 20, len(whole) - 1):
        table.write_bytes(whole[:end])
        journal = Journal(table, ABOUT)
        assert list(journal.rows) == ['first']
        journal.add('second', {**ROW, 'x': float('inf')})
        assert table.read_bytes() == whole


def test_what_differs_is_named(table: Path) -> None:
    before = table.read_bytes()
    with pytest.raises(InputError, match='other config; name another file'):
        Journal(table, {**ABOUT, 'config': {'search.parts': 4}})
    with pytest.raises(InputError, match='other bones, seed'):
        Journal(table, {**ABOUT, 'seed': 2, 'bones': {}})
    assert table.read_bytes() == before


@pytest.mark.parametrize('content', [b'x,y,z\n1,2,3\n', b'# {"seed"', b'\xff\xfe\x00', b'# {}'])
def test_other_files_are_left_alone(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / 'other'
    path.write_bytes(content)
    with pytest.raises(InputError, match='is no table of a benchmark'):
        Journal(path, ABOUT)
    assert path.read_bytes() == content


def test_a_damaged_row_is_named(table: Path) -> None:
    lines = table.read_text().splitlines()
    lines[2] = lines[2][:-3] + '\t}'
    table.write_text('\n'.join(lines) + '\n')
    with pytest.raises(InputError, match='line 3: this is no row'):
        Journal(table, ABOUT)


def test_columns_cannot_change(table: Path) -> None:
    with pytest.raises(ValueError, match='columns'):
        Journal(table, ABOUT).add('third', {'x': 1.0})


def test_an_empty_file_is_begun(tmp_path: Path) -> None:
    path = tmp_path / 'empty.tsv'
    path.touch()
    Journal(path, ABOUT).add('a', ROW)
    assert list(Journal(path, ABOUT).rows) == ['a']


def test_the_sources_have_one_hash() -> None:
    assert source_hash() == source_hash() and len(source_hash()) == 64
