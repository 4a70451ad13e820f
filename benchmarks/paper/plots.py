# SPDX-License-Identifier: Apache-2.0
"""Plot error and time against noise and outliers; needs plotly."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go

from benchmarks.execution.result_table import Row
from benchmarks.html import document
from benchmarks.paper.published import LEVELS
from benchmarks.paper.tables import Figures, figures

Levels = dict[float, str]       # of noise or outliers -> scenario

NOISE: Levels = {0.5: 'clean', 0.7: 'sigma_0.7', 0.9: 'sigma_0.9', 1.2: 'sigma_1.2'}
OUTLIERS: Levels = {0: 'clean', **{share: f'uniform_{share}' for share in (10, 30, 50, 70, 90)}}
AXES = {'noise': (NOISE, 'noise per axis, mm'), 'outliers': (OUTLIERS, 'outliers, % of points')}
# field of `Figures` -> axis title, index in the published figures
ERRORS = {'rotation': ('MAE of rotation, degrees', 0),
          't_centroid': ('MAE of translation at the centroid, mm', 1), 'seconds': ('time, s', 2)}


def page(rows: Sequence[Row]) -> str:
    """Return a self-contained HTML page with a plot for each error and axis."""
    return document('python -m benchmarks paper',
                    [_plot(rows, against, error) for against in AXES for error in ERRORS])


def _plot(rows: Sequence[Row], against: str, error: str) -> go.Figure:
    levels, x_title = AXES[against]
    y_title, index = ERRORS[error]
    plot = go.Figure(layout={
        'title': f'{y_title.partition(",")[0]} against {against}', 'xaxis': {'title': x_title},
        'yaxis': {'title': y_title, 'type': 'log'}, 'template': 'plotly_white', 'height': 520})
    for method in dict.fromkeys(row['method'] for row in rows):
        found: dict[float, Figures] = {}
        for level, scenario in levels.items():
            selected = [row for row in rows
                        if (row['method'], row['scenario']) == (method, scenario)]
            if any(row['status'] == 'answered' for row in selected):
                found[level] = figures(selected)
        if len(found) > 1:
            width = 4 if method == 'gsdf' else 1.5
            plot.add_scatter(x=list(found), y=[getattr(f, error) for f in found.values()],
                                name=method, line={'width': width})
    plot.add_scatter(
        x=[level for level, scenario in levels.items() if scenario in LEVELS],
        y=[LEVELS[scenario][index] for scenario in levels.values() if scenario in LEVELS],
        name='the paper (published)', line={'dash': 'dash', 'color': 'black'})
    return plot
