# SPDX-License-Identifier: Apache-2.0
"""The plots of the report as SVG: residuals in the order of the points, the time line, scales."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.report_content import ReportContent

WIDTH, HEIGHT = 900, 200        # of a plot, units of its view box
LEFT, RIGHT, TOP, BOTTOM = 64, 10, 20, 20       # margins
MOST_DOTS = 4000                # more cannot be distinguished
BINS = 6                        # colours of the dots


def scale_bar(scale: tuple[str, ...], limit: float, title: str, mark: float | None = None) -> str:
    """Return the legend of a fixed scale from zero to ``limit``, m; ``mark``: a line on it, m."""
    stops = ', '.join(scale)
    line = '' if mark is None else f'<i style="left:{100.0 * mark / limit:.1f}%"></i>'
    ticks = ''.join(f'<span>{1e3 * share * limit:.3g}</span>' for share in (0.0, 0.5, 1.0))
    return (f'<div class="scale"><b>{html.escape(title)}</b><div style="background:'
            f'linear-gradient(90deg, {stops})">{line}</div><p>{ticks}</p></div>')


def residual_plot(content: ReportContent) -> str:
    """Return the residuals in the order of the points; empty if they are not known."""
    residuals, inlier = content.residuals, content.inlier
    known = np.flatnonzero(np.isfinite(residuals))
    if not len(known):
        return ''
    known = known[::-(-len(known) // MOST_DOTS)]
    limit = colours.max_residual(content.config.limits)
    x = LEFT + (WIDTH - LEFT - RIGHT) * known / max(len(residuals) - 1, 1)
    y = _level(np.clip(residuals[known], -limit, limit), limit)
    levels = (-limit, -limit / 2, 0.0, limit / 2, limit)
    rows = [f'<path class="grid" d="M{LEFT} {_level(value, limit):.1f}H{WIDTH - RIGHT}"/>'
            f'<text x="{LEFT - 6}" y="{_level(value, limit) + 5:.1f}" text-anchor="end">'
            f'{_signed(1e3 * value)}</text>' for value in levels]
    shade = np.minimum(np.abs(residuals[known]) / limit * BINS, BINS - 1).astype(int)
    for number in range(BINS):
        colour = _hex(colours.on_scale(np.array((number + 0.5) / BINS), colours.RESIDUAL, 1.0))
        rows.append(_dots(x, y, inlier[known] & (shade == number), colour))
    rows.append(_dots(x, y, ~inlier[known], colours.UNUSED))
    return svg(HEIGHT, rows, 'residuals in the order of the points')


def time_line(content: ReportContent) -> str:
    """Return when each stroke, landmark and verification point was touched; empty if not known."""
    stamps = content.points.stamps
    if not content.timed or not len(stamps):
        return ''
    events = [*content.landmark_stamps, *(each.stamp for each in content.verifications)]
    start, end = min([stamps.min(), *events]), max([stamps.max(), *events])
    span = max(float(end - start), 1e-3)

    def place(stamp: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * float(stamp - start) / span
    rows = [row.format(x=place(first), width=max(place(last) - place(first), 2.0))
            for row, first, last in _strokes(content)]
    names = (*content.landmarks.names, *(each.name for each in content.verifications))
    for kind, name, stamp in zip(
            ['landmark'] * len(content.landmark_stamps) + ['verified'] * len(content.verifications),
            names if len(content.landmark_stamps) else names[len(content.landmarks):], events):
        rows.append(f'<path class="{kind}" d="M{place(stamp):.1f} 12v56"><title>'
                    f'{html.escape(name)}, {stamp - start:.1f} s</title></path>')
    for share in (0.0, 0.5, 1.0):
        anchor = 'start' if share == 0.0 else 'end' if share == 1.0 else 'middle'
        rows.append(f'<text x="{place(start + share * span):.1f}" y="94" text-anchor="{anchor}">'
                    f'{share * span:.0f} s</text>')
    return svg(100, rows, 'when the points were collected')


def _strokes(content: ReportContent) -> Iterator[tuple[str, float, float]]:
    """Yield a bar with the places {x} and {width}, and first and last stamp, of each stroke."""
    stamps, strokes, inlier = content.points.stamps, content.points.strokes, content.inlier
    for number in np.unique(strokes).tolist():
        own = strokes == number
        on_bone = own & inlier
        rms = float(np.sqrt(np.mean(content.residuals[on_bone]**2))) if on_bone.any() else 0.0
        limit = colours.max_residual(content.config.limits)
        colour = _hex(colours.on_scale(np.array(rms), colours.RESIDUAL, limit)) \
            if on_bone.any() else colours.UNUSED
        yield (f'<rect x="{{x:.1f}}" width="{{width:.1f}}" y="24" height="32" fill="{colour}">'
               f'<title>stroke {number}: {int(own.sum())} points</title></rect>',
               stamps[own].min(), stamps[own].max())


def _level(value: Array | float, limit: float) -> Array:
    """Return the height of a residual in the plot."""
    return np.asarray(TOP + (HEIGHT - TOP - BOTTOM) * (0.5 - 0.5 * np.asarray(value) / limit))


def _dots(x: Array, y: Array, chosen: np.ndarray, colour: str) -> str:
    places = ''.join(f'M{a:.1f} {b:.1f}h0' for a, b in zip(x[chosen], y[chosen]))
    return f'<path class="dots" stroke="{colour}" d="{places}"/>' if places else ''


def _signed(value: float) -> str:
    return f'{value:+.3g}' if value else '0'


def _hex(colour: Array) -> str:
    red, green, blue = np.round(255.0 * colour).astype(int).tolist()
    return f'#{red:02x}{green:02x}{blue:02x}'


def svg(height: int, rows: Sequence[str], label: str) -> str:
    """Return a plot as wide as the page, with an accessible name."""
    return (f'<svg class="plot" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{label}">'
            f'{"".join(rows)}</svg>')
