# SPDX-License-Identifier: Apache-2.0
"""The number of points needed with guidance and at random, as tables and plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.execution.result_table import Row
from benchmarks.guided.runs import GOALS, STRATEGIES
from gsdf_registration.common.rigid import Array, rms

COLUMNS = ('bone and region', 'runs', 'random', 'guided', 'fewer', 'fewer/same/more', 'error then',
           'random', 'guided', 'fewer', 'never', 'random', 'guided', 'fewer')
# goal -> the strategy that pursues it
GUIDED = {goal: strategy for strategy, goal in STRATEGIES.items() if goal}

Pair = tuple[float, float]      # random, guided


@dataclass(frozen=True)
class Needed:
    """
    Number of points until an error is within the limit; pairs are random and guided.

    predicted : for the predicted TRE; mean over runs, a run that never reaches the limit counts
        with all its points
    paired : runs in which guidance needed fewer, as many, and more points
    error : m, RMS over runs of the true TRE at that moment
    unambiguous : for the predicted TRE, without an alternative pose
    never : runs that never reached that
    true : for the RMS over all runs of the true TRE, interpolated between strokes; None: never
    """

    runs: int
    predicted: Pair
    paired: tuple[int, int, int]
    error: Pair
    unambiguous: Pair
    never: tuple[int, int]
    true: tuple[float | None, float | None]


def needed(rows: Sequence[Row], goal: str, limit: float) -> Needed:
    """Return the points needed for a goal and a limit, m; ``rows`` of both strategies and seeds."""
    random, guided = (
        {(row['case'], row['seed']): row for row in rows if row['strategy'] == strategy}
        for strategy in ('random', GUIDED[goal]))
    sides = [[side[key] for key in random if key in guided] for side in (random, guided)]
    stops = [[_stop(row, goal, limit, False) for row in side] for side in sides]
    clear = [[_stop(row, goal, limit, True) for row in side] for side in sides]
    points = [_at(side, ends, 'points') for side, ends in zip(sides, stops)]
    gain = points[1] - points[0]
    return Needed(
        runs=len(gain), predicted=(points[0].mean(), points[1].mean()),
        paired=(int((gain < 0).sum()), int((gain == 0).sum()), int((gain > 0).sum())),
        error=(rms(_at(sides[0], stops[0], f'true_{goal}_m')),
               rms(_at(sides[1], stops[1], f'true_{goal}_m'))),
        unambiguous=(_at(sides[0], clear[0], 'points').mean(),
                     _at(sides[1], clear[1], 'points').mean()),
        never=(clear[0].count(None), clear[1].count(None)),
        true=(_crossing(sides[0], goal, limit), _crossing(sides[1], goal, limit)))


def table(rows: Sequence[Row], goal: str, limit: float) -> list[tuple[str, ...]]:
    """Return the lines of the table of a goal: each bone and region, then all; cells as text."""
    lines: list[tuple[str, ...]] = []
    for case in [*sorted({row['case'] for row in rows}), 'all']:
        found = needed([row for row in rows if case in (row['case'], 'all')], goal, limit)
        lines.append((
            case, str(found.runs), *_side_by_side(found.predicted),
            '{}/{}/{}'.format(*found.paired), '{:.2f}, {:.2f}'.format(*1e3 * np.array(found.error)),
            *_side_by_side(found.unambiguous), '{}, {}'.format(*found.never),
            *_side_by_side(found.true)))
    return lines


def page(rows: Sequence[Row], limit: float) -> str:
    """Return a self-contained HTML page with a plot for each goal; needs plotly."""
    from benchmarks.html import document
    return document('python -m benchmarks guided', [_plot(rows, goal, limit) for goal in GOALS])


def _plot(rows: Sequence[Row], goal: str, limit: float) -> Any:
    """Return the plot of predicted (median) and true (RMS) error against the number of points."""
    import plotly.graph_objects as go
    plot = go.Figure(layout={
        'title': f'expected and true error {GOALS[goal]}', 'xaxis': {'title': 'points'},
        'yaxis': {'title': 'TRE, mm', 'type': 'log'}, 'template': 'plotly_white', 'height': 520})
    for strategy, colour in (('random', 'firebrick'), (GUIDED[goal], 'seagreen')):
        selected = [row for row in rows if row['strategy'] == strategy]
        word = strategy.partition('_')[0]
        predicted = [np.median([np.inf if tre is None else tre for tre in tres])
                     for tres in zip(*(row[f'predicted_{goal}_m'] for row in selected))]
        for name, values, dash in (
                (f'{word}, true (RMS over runs)', true_rms(selected, goal), 'solid'),
                (f'{word}, predicted (median)', predicted, 'dash')):
            plot.add_scatter(x=selected[0]['points'], y=[1e3 * value for value in values],
                             name=name, line={'color': colour, 'dash': dash, 'width': 3})
    plot.add_hline(1e3 * limit, line={'color': 'gray', 'dash': 'dot'})
    return plot


def _stop(row: Row, goal: str, limit: float, unambiguous: bool) -> int | None:
    """Return after how many strokes the predicted TRE is within the limit; None: never."""
    return next((k for k, tre in enumerate(row[f'predicted_{goal}_m'])
                 if tre is not None and tre <= limit
                 and not (unambiguous and row['ambiguous'][k])), None)


def _at(rows: Sequence[Row], stops: Sequence[int | None], column: str) -> Array:
    """Return the values (n,) of a column where each run stopped, or at its end."""
    return np.array([row[column][-1 if stop is None else stop] for row, stop in zip(rows, stops)])


def _crossing(rows: Sequence[Row], goal: str, limit: float) -> float | None:
    """Return the number of points at which the RMS of the true TRE reaches the limit."""
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
    """Return as text the points needed at random and guided, and the reduction."""
    random, guided = points
    fewer = ('-' if random is None or guided is None else
             f'{100.0 * (1.0 - guided / random):.0f} %')
    return (*('never' if count is None else f'{count:.0f}' for count in points), fewer)
