# SPDX-License-Identifier: Apache-2.0
"""The page of an archive: counts, distributions, and a list that stays small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gsdf_registration.visualization import archive_statistics
from gsdf_registration.visualization.archive_page import write_page
from gsdf_registration.visualization.archive_statistics import Statistics

NAMES = ('label', 'setting', 'message', 'grade', 'notes', 'report', 'version')


def row(number: int, reason: str = 'converged', **more: Any) -> dict[str, Any]:
    error = 0.001 * number if reason == 'converged' else None
    return {**dict.fromkeys(NAMES, ''), 'bag': f'bag <{number}>', 'reason': reason, 'used': 9,
            'received': 10, 'required_p95_m': error, 'true_required_m': None, 'true_rms_m': None,
            'total_s': 1.0 / number, 'result': f'results/a b{number}.json', **more}


ROWS = [row(number, 'ambiguous' if number % 4 == 0 else 'converged') for number in range(1, 41)]


def page(tmp_path: Path, rows: list[dict[str, Any]], missing: int = 0) -> str:
    write_page(tmp_path / 'a.html', iter(rows), missing, ['results.csv'])
    return (tmp_path / 'a.html').read_text()


def test_counts_outcomes_and_errors(tmp_path: Path) -> None:
    found = Statistics(ROWS)
    assert (found.total, found.registered) == (40, 30)
    assert [each['bag'] for each in found.slowest()[:2]] == ['bag <1>', 'bag <2>']
    name, worst = found.worst()
    assert name == 'required_p95_m' and [each['bag'] for each in worst[:3]] == [
        'bag <39>', 'bag <38>', 'bag <37>']
    assert Statistics([*ROWS, row(1, true_required_m=0.5)]).worst()[0] == 'true_required_m'
    text = page(tmp_path, ROWS)
    assert '30 of 40 registered' in text and 'not registered: 10 ambiguous' in text
    assert 'median 20.00, 95 % below 37.55, largest 39.00 mm' in text
    assert 'href="results/a%20b7.json">bag &lt;7&gt;</a>' in text and 'bag <7>' not in text


def test_settings_are_compared(tmp_path: Path) -> None:
    rows = [row(1, setting='m=1'), row(2, 'ambiguous', setting='m=1'), row(3, setting='m=2')]
    text = page(tmp_path, rows)
    assert 'Settings compared' in text and 'data-title="setting">m=2<' in text
    assert '1 of 2' in text and '1 of 1' in text
    assert 'Settings compared' not in page(tmp_path, ROWS)


def test_the_list_of_a_large_archive_has_its_first_rows_and_the_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive_statistics, 'MOST_LISTED', 5)
    rows = [row(1) for _ in range(20)] + [row(1, 'ambiguous', bag='late')]
    text = page(tmp_path, rows)
    assert 'The first 5 results' in text and text.partition('id=')[2].count('late') == 1
    assert text.count('<tr>') < 40


def test_a_run_that_was_stopped_says_what_is_missing(tmp_path: Path) -> None:
    assert '2 results missing' in page(tmp_path, ROWS, 2)
    assert '0 of 0 registered' in page(tmp_path, [], 3)
