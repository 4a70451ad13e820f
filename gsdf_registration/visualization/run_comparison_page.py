# SPDX-License-Identifier: Apache-2.0
"""The differences of two runs over an archive, as text and as a page."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

from gsdf_registration.common.formatting import format_count
from gsdf_registration.registration.run_comparison import Pair, Row, RunComparison, verdict
from gsdf_registration.visualization.archive_page import section, styles, table_of
from gsdf_registration.visualization.report import page, tables
from gsdf_registration.visualization.report_table import Rows, setting

MOST_LINES, MOST_ROWS = 40, 2000        # of the text, and of a table of the page
Settings = Mapping[str, Sequence[tuple[Any, Any]]]      # name -> values in A and B


def counts(found: RunComparison) -> Rows:
    """Return how many results changed, in words."""
    rows = [('same to the bit', str(found.same)),
            (f'moved by at most {_mm(found.limit_m)}', str(found.near)),
            ('moved by more', str(len(found.moved))),
            ('another verdict', str(len(found.verdicts))),
            ('only in A', str(len(found.only_a))), ('only in B', str(len(found.only_b)))]
    if found.other_content:
        rows.append(('of these: the recording differs', str(found.other_content)))
    if found.versions[0] != found.versions[1]:
        rows.append(('versions, A and B', '  |  '.join(
            ', '.join(sorted(each)) for each in found.versions)))
    return rows


def changes(found: RunComparison) -> list[tuple[str, str, str, Row]]:
    """Return each change: recording, what it was and what it is, distance, row with a result."""
    rows = [(_name(pair.a), f'{pair.verdicts[0]} -> {pair.verdicts[1]}', _moved(pair), pair.b)
            for pair in found.verdicts]
    rows += [(_name(pair.a), pair.verdicts[0], _moved(pair), pair.b) for pair in found.moved]
    rows += [(_name(row), f'{verdict(row)}, only in {run}', '', row)
             for run, only in (('A', found.only_a), ('B', found.only_b)) for row in only]
    return rows


def comparison_text(found: RunComparison, settings: Settings, names: tuple[str, str]) -> str:
    """Return the differences as text; ``names`` of the folders A and B."""
    lines = ['Runs', *(f'  {name:<32} {folder}' for name, folder in zip('AB', names)),
             f'{format_count(found.pairs, "result")} in both runs',
             *(f'  {name:<32} {value}' for name, value in counts(found))]
    listed = changes(found)
    if listed:
        lines += ['Changed', *(f'  {bag}: {what}{f", {moved}" if moved else ""}'
                               for bag, what, moved, _ in listed[:MOST_LINES])]
    if len(listed) > MOST_LINES:
        lines.append(f'  and {len(listed) - MOST_LINES} more: see --report')
    return '\n'.join([*lines, 'Settings that differ, A and B',
                      *(f'  {name:<32} {value}'.rstrip() for name, value in _settings(settings))])


def write_comparison(path: str | os.PathLike[str], found: RunComparison, settings: Settings,
                     names: tuple[str, str]) -> None:
    """Write the differences as an HTML page; replace an existing one. Links lead to run B."""
    from msg_adapters.files import write_atomically
    listed = changes(found)
    headline = f'{len(listed)} changed' if listed else 'nothing changed'
    folder = os.path.relpath(names[1], os.path.dirname(os.path.abspath(path)))
    shown = table_of([('recording', ''), ('verdict', ''), ('distance', 'number')], (
        [_link(bag, row, folder if 'only in A' not in what else ''), html.escape(what), moved]
        for bag, what, moved, row in listed[:MOST_ROWS]))
    body = (f'{styles()}<h1>Comparison of two runs</h1><div class="outcome '
            f'{"bad" if listed else "good"}"><b>{headline}</b>A: {html.escape(names[0])}<br>'
            f'B: {html.escape(names[1])}</div>'
            + section('Changed', shown if listed else '')
            + '<div class="tables wide">' + tables({
                f'{format_count(found.pairs, "result")} in both runs': counts(found),
                'Settings that differ, A and B': _settings(settings)}) + '</div>')
    write_atomically(path, page('Comparison of two runs', body))


def _settings(settings: Settings) -> Rows:
    return [(name, '; '.join(f'{setting(a)}  |  {setting(b)}' for a, b in values))
            for name, values in settings.items()] or [('none', '')]


def _name(row: Row) -> str:
    about = ', '.join(row[name] for name in ('label', 'setting') if row[name])
    return f'{row["bag"]} ({about})' if about else str(row['bag'])


def _moved(pair: Pair) -> str:
    if not pair.comparable:
        return 'another bone or frame, so the poses cannot be compared'
    return '' if pair.moved_m is None else _mm(pair.moved_m)


def _mm(metres: float) -> str:
    return f'{1e3 * metres:.2f} mm'


def _link(name: str, row: Row, folder: str) -> str:
    """Return a name as a link to the report or the result in a folder, empty: no link."""
    target = row['report'] or row['result']
    if not folder or not target:
        return html.escape(name)
    return f'<a href="{quote(os.path.join(folder, target))}">{html.escape(name)}</a>'
