# SPDX-License-Identifier: Apache-2.0
"""The plots of the page of an archive as SVG: distributions of errors."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization.report_plots import LEFT, RIGHT, WIDTH, svg

BINS = 40
HEIGHT, TOP, BOTTOM = 120, 6, 38        # of a plot, and its margins
STEPS = (1.0, 2.0, 5.0)                 # of the scale, times a power of ten


def histograms(values: Mapping[str, Array], title: str) -> str:
    """
    Return the distribution of a length for each setting, on one scale, as HTML.

    The last bar has everything beyond the scale, which ends at the 99th percentile of all.

    Parameters
    ----------
    values : setting -> (n,) float, m
    title : of the plot

    """
    known = {setting: 1e3 * each for setting, each in values.items() if len(each)}
    if not known:
        return ''
    end = _rounded_up(float(np.percentile(np.concatenate(list(known.values())), 99.0)))
    plots = [f'<p>{_in_words(setting, each)}</p>' + svg(
        HEIGHT, [_bars(each, end)], html.escape(f'{title}: distribution. {setting}'))
        for setting, each in known.items()]
    return f'<h3>{html.escape(title)}</h3>{"".join(plots)}'


def _in_words(setting: str, values: Array) -> str:
    median, high = np.percentile(values, [50.0, 95.0])
    return (html.escape(f'{setting}: ' if setting else '')
            + f'median {median:.2f}, 95 % below {high:.2f}, largest {values.max():.2f} mm')


def _bars(values: Array, end: float) -> str:
    """Return the bars of a setting, and the scale."""
    width, floor = (WIDTH - LEFT - RIGHT) / BINS, HEIGHT - BOTTOM
    counts = np.histogram(np.minimum(values, 0.9999 * end), BINS, (0.0, end))[0]
    bars = ''.join(
        f'<rect class="share" x="{LEFT + number * width:.1f}" width="{width:.1f}" '
        f'y="{floor - height:.1f}" height="{height:.1f}"><title>'
        f'{number * end / BINS:.3g} to {(number + 1) * end / BINS:.3g} mm: {count}</title></rect>'
        for number, count in enumerate(counts.tolist()) if count
        for height in [(floor - TOP) * count / counts.max()])
    ticks = ''.join(
        f'<text x="{LEFT + share * (WIDTH - LEFT - RIGHT):.0f}" y="{HEIGHT - 10}" text-anchor='
        f'"{"end" if share == 1.0 else "middle"}">{share * end:.3g}{" +" if share == 1.0 else ""}'
        '</text>' for share in (0.0, 0.25, 0.5, 0.75, 1.0))
    return f'<path class="grid" d="M{LEFT} {floor}H{WIDTH - RIGHT}"/>{bars}{ticks}'


def _rounded_up(value: float) -> float:
    """Return the next larger 1, 2 or 5 times a power of ten."""
    if value <= 0.0:
        return 1.0
    power = 10.0**math.floor(math.log10(value))
    return next((step * power for step in STEPS if value <= step * power), 10.0 * power)
