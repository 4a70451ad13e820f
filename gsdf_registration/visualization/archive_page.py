# SPDX-License-Identifier: Apache-2.0
"""The page of an archive: one HTML file that needs no network, with links to each result."""

from __future__ import annotations

import html
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from urllib.parse import quote

import numpy as np

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization.archive_plots import histograms
from gsdf_registration.visualization.archive_statistics import (
    MEASURES,
    SUCCESS,
    Row,
    Statistics,
)
from gsdf_registration.visualization.report import asset, page

# of a list of results; a narrow screen leaves those of the class "more" out
COLUMNS = (('recording', ''), ('outcome', ''), ('stated error', 'number'),
           ('true error', 'number'), ('used', 'number more'), ('time', 'number'),
           ('notes', 'more'))
NOTE = (
    'Errors are those at the places where the pose must be accurate: the targets, else the bone '
    'within 100 mm of the touched points. The <b>stated error</b> is the 95 % bound that follows '
    'from the points. The <b>true error</b> is known for recordings with a ground truth.')


def write_page(path: str | os.PathLike[str], rows: Iterable[Row], missing: int,
               tables: Sequence[str]) -> None:
    """
    Write the page of an archive; replace an existing one.

    Parameters
    ----------
    path : of the page
    rows : of the table, in its order; they are seen once
    missing : number of rows that were not computed, because the run was stopped
    tables : names of the files of the table, beside the page

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    from msg_adapters.files import write_atomically
    write_atomically(path, page('Archive of recordings',
                                _body(Statistics(rows), missing, tables)))


def table_of(header: Sequence[tuple[str, str]], rows: Iterable[Sequence[str]],
             name: str = '') -> str:
    """
    Return a table as HTML.

    Parameters
    ----------
    header : title and class of each column
    rows : cells as HTML
    name : of the table, for scripts

    """
    head = ''.join(f'<th class="{kind}">{title}</th>' for title, kind in header)
    body = '\n'.join('<tr>' + ''.join(
        f'<td class="{kind}" data-title="{title}">{cell}</td>'
        for cell, (title, kind) in zip(cells, header)) + '</tr>'
        for cells in rows)
    return (f'<div class="list"><table{f" id={name!r}" if name else ""}><thead><tr>{head}</tr>'
            f'</thead><tbody>\n{body}\n</tbody></table></div>')


def section(heading: str, content: str) -> str:
    """Return a part of the page; nothing without content."""
    return (f'<section class="wide"><h2>{html.escape(heading)}</h2>{content}</section>'
            if content else '')


def styles() -> str:
    """Return the style of lists, in addition to that of the reports."""
    return f'<style>\n{asset("archive.css")}</style>'


def _body(found: Statistics, missing: int, tables: Sequence[str]) -> str:
    column, worst = found.worst()
    kind = 'true' if column.startswith('true') else 'stated'
    complete = len(found.listed) == found.total
    parts = (
        styles(), '<h1>Archive of recordings</h1>', _outcome(found, missing),
        _facts(found, tables), section('Outcomes', _bars(found)),
        section('Settings compared', _settings(found) if len(found.reasons) > 1 else ''),
        section('Errors of the registered', _histograms(found)), f'<p class="note">{NOTE}</p>',
        section(f'Largest {kind} errors', _list(worst) if worst else ''),
        section('Slowest', _list(found.slowest()) if found.total else ''),
        section('All results' if complete else f'The first {len(found.listed)} results, and '
                'others that were not registered; the table has all',
                _FILTER + _list([*found.listed, *found.unusual], 'all') if found.total else ''),
        f'<script>\n{asset("archive.js")}</script>')
    return '\n'.join(part for part in parts if part)


_FILTER = ('<div id="buttons"><input id="words" type="search" placeholder="search" '
           'aria-label="search"><label><input id="refused" type="checkbox"> only those not '
           'registered</label><span id="shown"></span></div>')


def _outcome(found: Statistics, missing: int) -> str:
    counts = sum(found.reasons.values(), Counter[str]())
    refused = ', '.join(f'{count} {_words(reason)}' for reason, count in _sorted(counts)
                        if reason != SUCCESS)
    stopped = (f'<br>The run was stopped: {format_count(missing, "result")} missing. Run the same '
               'command again to continue.') if missing else ''
    kind = 'good' if found.registered == found.total and not missing else 'bad'
    return (f'<div class="outcome {kind}"><b>{found.registered} of {found.total} registered</b>'
            + html.escape(f'not registered: {refused}' if refused else '') + stopped + '</div>')


def _facts(found: Statistics, tables: Sequence[str]) -> str:
    grades = sum(found.grades.values(), Counter[str]())
    known = {
        'grades': ', '.join(f'{count} {grade}' for grade, count in sorted(grades.items())),
        'settings': str(len(found.reasons)) if len(found.reasons) > 1 else '',
        'version': ', '.join(sorted(found.versions))}
    shown = {name: html.escape(value) for name, value in known.items() if value}
    shown['table'] = ', '.join(f'<a href="{name}">{name}</a>' for name in tables)
    return '<dl class="facts">' + ''.join(
        f'<div><dt>{name}</dt><dd>{value}</dd></div>' for name, value in shown.items()) + '</dl>'


def _bars(found: Statistics) -> str:
    """Return a bar for each reason; its length is the share of all results."""
    counts = sum(found.reasons.values(), Counter[str]())
    return '<div class="bars">' + ''.join(
        f'<div class="gauge {"good" if reason == SUCCESS else "bad"}"><b>{_outcome_word(reason)}'
        f'</b><span>{count} of {found.total}</span><div><i style="width:'
        f'{100.0 * count / found.total:.1f}%"></i></div></div>'
        for reason, count in _sorted(counts)) + '</div>'


def _settings(found: Statistics) -> str:
    """Return a table with a row for each setting of a sweep."""
    header = [('setting', ''), ('registered', 'number'), ('grade A', 'number'),
              ('not registered', ''), *((f'{name}, mm: median, 95 %, largest', 'number')
                                        for name in ('stated error', 'true error')),
              ('time: median', 'number')]
    rows = []
    for setting, counts in found.reasons.items():
        refused = ', '.join(f'{count} {_words(reason)}' for reason, count in _sorted(counts)
                            if reason != SUCCESS)
        rows.append([html.escape(setting),
                     f'{counts[SUCCESS]} of {sum(counts.values())}',
                     str(found.grades.get(setting, Counter())['A']), html.escape(refused),
                     *(_three(found.values(setting, name))
                       for name in ('required_p95_m', 'true_required_m')),
                     _median(found.values(setting, 'total_s'))])
    return table_of(header, rows)


def _three(values: Array) -> str:
    if not len(values):
        return ''
    return ', '.join(f'{1e3 * value:.2f}' for value in np.percentile(values, [50.0, 95.0, 100.0]))


def _median(seconds: Array) -> str:
    return f'{np.median(seconds):.2f} s' if len(seconds) else ''


def _histograms(found: Statistics) -> str:
    return ''.join(histograms({setting: found.values(setting, name) for setting in found.reasons},
                              title) for name, title in MEASURES.items())


def _list(rows: Sequence[Row], name: str = '') -> str:
    """Return rows of the table as HTML, with a link each; a list with a name has the messages."""
    return table_of(COLUMNS, (_cells(row, bool(name)) for row in rows), name)


def _cells(row: Row, messages: bool) -> list[str]:
    good = row['reason'] == SUCCESS
    about = ', '.join(html.escape(row[name]) for name in ('label', 'setting') if row[name])
    grade = f' ({row["grade"]})' if row['grade'] else ''
    message = '' if good or not messages else f'<small>{html.escape(row["message"] or "")}</small>'
    notes = (row['notes'] or '').split(' | ') if row['notes'] else []
    return [
        _link(row) + (f'<small>{about}</small>' if about else ''),
        f'<b class="{"good" if good else "bad"}">{_outcome_word(row["reason"])}{grade}</b>'
        + message,
        _mm(row['required_p95_m'] if good else None), _mm(row['true_required_m']),
        f'{row["used"]} of {row["received"]}' if row['received'] else '',
        '' if row['total_s'] is None else f'{row["total_s"]:.2f} s',
        f'<span title="{html.escape(row["notes"])}">{format_count(len(notes), "note")}</span>'
        if notes else '']


def _link(row: Row) -> str:
    """Return the name of a recording as a link to its report, else to its result."""
    name, target = html.escape(row['bag']), row['report'] or row['result']
    return f'<a href="{quote(target)}">{name}</a>' if target else name


def _mm(metres: float | None) -> str:
    return '' if metres is None else f'{1e3 * metres:.2f} mm'


def _outcome_word(reason: str) -> str:
    return 'registered' if reason == SUCCESS else html.escape(_words(reason))


def _words(reason: str) -> str:
    return reason.replace('_', ' ')


def _sorted(counts: Counter[str]) -> list[tuple[str, int]]:
    """Return reasons and their numbers: success first, then the most frequent."""
    return sorted(counts.items(), key=lambda item: (item[0] != SUCCESS, -item[1], item[0]))
