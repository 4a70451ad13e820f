# SPDX-License-Identifier: Apache-2.0
"""Error against noise, against outliers, and time: curves of the tables; needs plotly."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go

from benchmarks.journal import Row
from benchmarks.published import LEVELS
from benchmarks.tables import Figures, figures

Levels = dict[float, str]       # of noise or outliers -> scenario

NOISE: Levels = {0.5: 'clean', 0.7: 'sigma_0.7', 0.9: 'sigma_0.9', 1.2: 'sigma_1.2'}
OUTLIERS: Levels = {0: 'clean', **{share: f'uniform_{share}' for share in (10, 30, 50, 70, 90)}}
AXES = {'noise': (NOISE, 'noise per axis, mm'), 'outliers': (OUTLIERS, 'outliers, % of points')}
# of Figures; and its place in what was published
ERRORS = {'rotation': ('MAE of rotation, degrees', 0),
          't_centroid': ('MAE of translation at the centroid, mm', 1), 'seconds': ('time, s', 2)}


def page(rows: Sequence[Row]) -> str:
    """Return a page of HTML that needs no network, a picture for each error and axis."""
    return document('gsdf bench paper',
                    [_picture(rows, against, error) for against in AXES for error in ERRORS])


def document(title: str, pictures: Sequence[go.Figure]) -> str:
    """Return a page of HTML that needs no network."""
    return f'<!DOCTYPE html>\n<meta charset="utf-8">\n<title>{title}</title>\n' + '\n'.join(
        picture.to_html(full_html=False, include_plotlyjs=number == 0)
        for number, picture in enumerate(pictures))


def _picture(rows: Sequence[Row], against: str, error: str) -> go.Figure:
    levels, below = AXES[against]
    beside, place = ERRORS[error]
    picture = go.Figure(layout={
        'title': f'{beside.partition(",")[0]} against {against}', 'xaxis': {'title': below},
        'yaxis': {'title': beside, 'type': 'log'}, 'template': 'plotly_white', 'height': 520})
    for method in dict.fromkeys(row['method'] for row in rows):
        found: dict[float, Figures] = {}
        for level, scenario in levels.items():
            own = [row for row in rows if (row['method'], row['scenario']) == (method, scenario)]
            if any(row['status'] == 'answered' for row in own):
                found[level] = figures(own)
        if len(found) > 1:
            width = 4 if method == 'gsdf' else 1.5
            picture.add_scatter(x=list(found), y=[getattr(f, error) for f in found.values()],
                                name=method, line={'width': width})
    picture.add_scatter(
        x=[level for level, scenario in levels.items() if scenario in LEVELS],
        y=[LEVELS[scenario][place] for scenario in levels.values() if scenario in LEVELS],
        name='the paper (published)', line={'dash': 'dash', 'color': 'black'})
    return picture
