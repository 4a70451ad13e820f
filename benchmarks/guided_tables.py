# SPDX-License-Identifier: Apache-2.0
"""What the runs of `guided` come to: points needed, side by side, in a table and in curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.guided import GOALS, WAYS
from benchmarks.journal import Row
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.acceptance import rms

COLUMNS = ('bone and region', 'runs', 'random', 'guided', 'fewer', 'fewer/same/more', 'error then',
           'random', 'guided', 'fewer', 'never', 'random', 'guided', 'fewer')
# goal -> the way that strives for it
STRIVES = {goal: way for way, goal in WAYS.items() if goal}

Pair = tuple[float, float]      # at random, guided


@dataclass(frozen=True)
class Needed:
    """
    Points until an error is no more than the limit; pairs are at random and guided.

    predicted : until the predicted TRE is; mean over runs, of a run that never gets there all
        its points
    paired : runs in which guidance needed fewer, as many, and more
    error : m, RMS over runs of the true TRE at that moment
    sure : until the predicted TRE is, and no other pose fits about as well
    never : runs that never got there
    true : until the RMS over all runs of the true TRE is, between strokes by interpolation; None:
        never
    """

    runs: int
    predicted: Pair
    paired: tuple[int, int, int]
    error: Pair
    sure: Pair
    never: tuple[int, int]
    true: tuple[float | None, float | None]


def needed(rows: Sequence[Row], goal: str, limit: float) -> Needed:
    """Return what ``rows`` (both ways, same seeds) say of a goal and a limit, m."""
    random, guided = ({(row['case'], row['seed']): row for row in rows if row['way'] == way}
                      for way in ('random', STRIVES[goal]))
    sides = [[side[key] for key in random if key in guided] for side in (random, guided)]
    stops = [[_stop(row, goal, limit, False) for row in side] for side in sides]
    sure = [[_stop(row, goal, limit, True) for row in side] for side in sides]
    points = [_at(side, ends, 'points') for side, ends in zip(sides, stops)]
    gain = points[1] - points[0]
    return Needed(
        runs=len(gain), predicted=(points[0].mean(), points[1].mean()),
        paired=(int((gain < 0).sum()), int((gain == 0).sum()), int((gain > 0).sum())),
        error=(rms(_at(sides[0], stops[0], f'true_{goal}_m')),
               rms(_at(sides[1], stops[1], f'true_{goal}_m'))),
        sure=(_at(sides[0], sure[0], 'points').mean(), _at(sides[1], sure[1], 'points').mean()),
        never=(sure[0].count(None), sure[1].count(None)),
        true=(_crossing(sides[0], goal, limit), _crossing(sides[1], goal, limit)))


def table(rows: Sequence[Row], goal: str, limit: float) -> list[tuple[str, ...]]:
    """Return the lines of the table of a goal, a bone and region each and all, cells as text."""
    lines: list[tuple[str, ...]] = []
    for case in [*sorted({row['case'] for row in rows}), 'all']:
        found = needed([row for row in rows if case in (row['case'], 'all')], goal, limit)
        lines.append((
            case, str(found.runs), *_side_by_side(found.predicted),
            '{}/{}/{}'.format(*found.paired), '{:.2f}, {:.2f}'.format(*1e3 * np.array(found.error)),
            *_side_by_side(found.sure), '{}, {}'.format(*found.never), *_side_by_side(found.true)))
    return lines


def page(rows: Sequence[Row], limit: float) -> str:
    """Return a page of HTML that needs no network, a picture for each goal; needs plotly."""
    from benchmarks.plots import document
    return document('gsdf bench guided', [_picture(rows, goal, limit) for goal in GOALS])


def _picture(rows: Sequence[Row], goal: str, limit: float) -> Any:
    """Return the error against the points held, predicted (median) and true (RMS), each way."""
    import plotly.graph_objects as go
    picture = go.Figure(layout={
        'title': f'expected and true error {GOALS[goal]}', 'xaxis': {'title': 'points'},
        'yaxis': {'title': 'TRE, mm', 'type': 'log'}, 'template': 'plotly_white', 'height': 520})
    for way, colour in (('random', 'firebrick'), (STRIVES[goal], 'seagreen')):
        own = [row for row in rows if row['way'] == way]
        word = way.partition('_')[0]
        predicted = [np.median([np.inf if tre is None else tre for tre in tres])
                     for tres in zip(*(row[f'predicted_{goal}_m'] for row in own))]
        for name, values, dash in ((f'{word}, true (RMS over runs)', true_rms(own, goal), 'solid'),
                                   (f'{word}, predicted (median)', predicted, 'dash')):
            picture.add_scatter(x=own[0]['points'], y=[1e3 * value for value in values], name=name,
                                line={'color': colour, 'dash': dash, 'width': 3})
    picture.add_hline(1e3 * limit, line={'color': 'gray', 'dash': 'dot'})
    return picture


def _stop(row: Row, goal: str, limit: float, sure: bool) -> int | None:
    """Return after how many strokes the predicted TRE is first met, if ``sure`` with no rival."""
    return next((k for k, tre in enumerate(row[f'predicted_{goal}_m'])
                 if tre is not None and tre <= limit and not (sure and row['ambiguous'][k])), None)


def _at(rows: Sequence[Row], stops: Sequence[int | None], column: str) -> Array:
    """Return the values (n,) of a column when each run stopped, or at its end."""
    return np.array([row[column][-1 if stop is None else stop] for row, stop in zip(rows, stops)])


def _crossing(rows: Sequence[Row], goal: str, limit: float) -> float | None:
    """Return at how many points the RMS of the true TRE first falls to the limit."""
    points, error = rows[0]['points'], true_rms(rows, goal)
    for k, now in enumerate(error):
        if now <= limit:
            if k == 0:
                return float(points[0])
            share = np.log(error[k - 1] / limit) / np.log(error[k - 1] / now)
            return float(points[k - 1] + share * (points[k] - points[k - 1]))
    return None


def true_rms(rows: Sequence[Row], goal: str) -> list[float]:
    """Return the RMS over runs of the true TRE, m, after each stroke."""
    return [rms(np.array(errors)) for errors in zip(*(row[f'true_{goal}_m'] for row in rows))]


def _side_by_side(points: tuple[float | None, float | None]) -> tuple[str, ...]:
    """Return how many points at random, guided, and by how much the latter are fewer."""
    random, guided = points
    fewer = ('-' if random is None or guided is None else
             f'{100.0 * (1.0 - guided / random):.0f} %')
    return (*('never' if count is None else f'{count:.0f}' for count in points), fewer)
