# SPDX-License-Identifier: Apache-2.0
"""Tables of rows: appended, continued after an interruption, rejected if inputs differ."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.execution.result_table import ResultTable, source_hash
from gsdf_registration.common.result import InputError

ABOUT = {'seed': 1, 'config': {'search.parts': 3}}
ROW = {'name': 'a\tb "c"\né', 'x': 0.1 + 0.2, 'n': 3, 'ok': True, 'none': None}


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / 'table.tsv'
    results = ResultTable(path, ABOUT)
    results.add('first', ROW)
    results.add('second', {**ROW, 'x': float('inf')})
    return path


def test_reads_the_rows_that_were_added(table: Path) -> None:
    rows = ResultTable(table, ABOUT).rows
    assert rows['first'] == {'job': 'first', **ROW}
    assert rows['second']['x'] == float('inf')
    lines = table.read_text().splitlines()
    assert json.loads(lines[0].removeprefix('# ')) == ABOUT
    assert lines[1].split('\t') == ['job', *ROW] and len(lines) == 4


def test_cuts_off_an_incomplete_last_row(table: Path) -> None:
    whole = table.read_bytes()
    last = whole.rstrip(b'\n').rfind(b'\n') + 1
    for end in (last, last + 1, len(whole) - 20, len(whole) - 1):
        table.write_bytes(whole[:end])
        results = ResultTable(table, ABOUT)
        assert list(results.rows) == ['first']
        results.add('second', {**ROW, 'x': float('inf')})
        assert table.read_bytes() == whole


def test_names_the_inputs_that_differ(table: Path) -> None:
    before = table.read_bytes()
    with pytest.raises(InputError, match='other config; give another file'):
        ResultTable(table, {**ABOUT, 'config': {'search.parts': 4}})
    with pytest.raises(InputError, match='other bones, seed'):
        ResultTable(table, {**ABOUT, 'seed': 2, 'bones': {}})
    assert table.read_bytes() == before


@pytest.mark.parametrize('content', [b'x,y,z\n1,2,3\n', b'# {"seed"', b'\xff\xfe\x00', b'# {}'])
def test_rejects_other_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / 'other'
    path.write_bytes(content)
    with pytest.raises(InputError, match='is not a table of a benchmark'):
        ResultTable(path, ABOUT)
    assert path.read_bytes() == content


def test_names_a_damaged_row(table: Path) -> None:
    lines = table.read_text().splitlines()
    lines[2] = lines[2][:-3] + '\t}'
    table.write_text('\n'.join(lines) + '\n')
    with pytest.raises(InputError, match='line 3: this is not a row'):
        ResultTable(table, ABOUT)


def test_rejects_other_columns(table: Path) -> None:
    with pytest.raises(ValueError, match='columns'):
        ResultTable(table, ABOUT).add('third', {'x': 1.0})


def test_writes_to_an_empty_file(tmp_path: Path) -> None:
    path = tmp_path / 'empty.tsv'
    path.touch()
    ResultTable(path, ABOUT).add('a', ROW)
    assert list(ResultTable(path, ABOUT).rows) == ['a']


def test_hash_of_the_sources_is_stable() -> None:
    assert source_hash() == source_hash() and len(source_hash()) == 64
