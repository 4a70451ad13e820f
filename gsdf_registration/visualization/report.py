# SPDX-License-Identifier: Apache-2.0
"""The report of a registration: one HTML file that needs no network."""

from __future__ import annotations

import html
import json
import os
from importlib.resources import files
from string import Template

from gsdf_registration.common.result import InputError
from gsdf_registration.visualization import colours, report_head
from gsdf_registration.visualization.report_content import ReportContent
from gsdf_registration.visualization.report_pictures import pictures
from gsdf_registration.visualization.report_plots import residual_plot, scale_bar, time_line
from gsdf_registration.visualization.report_scene import scene
from gsdf_registration.visualization.report_table import Rows, sections

ACCURACY_NOTE = (
    'The <b>error</b> is what to expect at a place on the bone. It follows from the noise of the '
    'points and from their distribution. The <b>residual</b> is the fit: how closely the points '
    'lie on the model. <b>It is NOT the accuracy</b>: points on a small or regular area can fit '
    'perfectly in the wrong place. Verify the pose on the bone with points that were not used.')
REFUSED_NOTE = (
    'There is <b>no pose</b>. What is drawn, and the numbers in the tables, belong to the best '
    'candidate, which was rejected and must not be used.')
NO_CANDIDATE_NOTE = 'There is <b>no pose</b>. Only the points are shown, in the tracker frame.'


def require_pillow() -> None:
    """Raise an `InputError` that says what to install if Pillow is missing."""
    try:
        import PIL.Image  # noqa: F401
    except ImportError:
        raise InputError('a report needs Pillow, which is not installed: '
                         "pip install 'gsdf_registration[report]'") from None


def write_report(path: str | os.PathLike[str], content: ReportContent) -> None:
    """
    Write the report of a registration as one self-contained HTML file; replace an existing one.

    Raises
    ------
    InputError
        If Pillow is not installed or the file cannot be written.

    """
    require_pillow()
    from msg_adapters.files import write_atomically
    write_atomically(path, _page(content))


def page(title: str, body: str) -> str:
    """Return an HTML page in the style of the reports."""
    return Template(asset('report_page.html')).substitute(
        title=html.escape(title), style=asset('report.css'), body=body)


def tables(sections: dict[str, Rows]) -> str:
    """Return tables of names and values as HTML."""
    return '\n'.join(
        f'<section><h2>{html.escape(heading)}</h2><table>' + ''.join(
            f'<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>'
            for name, value in rows) + '</table></section>'
        for heading, rows in sections.items())


def _page(content: ReportContent) -> str:
    result = content.result
    outcome = 'Registered' if result.success else f'Refused: {result.reason}'
    note = (ACCURACY_NOTE if result.success
            else NO_CANDIDATE_NOTE if content.pose is None else REFUSED_NOTE)
    drawn = json.dumps(scene(content), allow_nan=False, separators=(',', ':'))
    return page(content.title, Template(asset('report.html')).substitute(
        title=html.escape(content.title), outcome=html.escape(outcome),
        kind='good' if result.success else 'bad', message=html.escape(result.message),
        facts=report_head.facts(content), gauges=report_head.gauge_bars(content),
        advice=report_head.advice(content), note=note, pictures=pictures(content),
        scales=_scales(content), scene=drawn.replace('<', '\\u003c'), plots=_plots(content),
        tables=tables(sections(content)), script=asset('report.js')))


def _scales(content: ReportContent) -> str:
    """Return the legends of the colours, which are the same in every report with these limits."""
    limits = content.config.limits
    if content.pose is None or content.field is None:
        return ''
    scales = [scale_bar(colours.RESIDUAL, colours.max_residual(limits),
                        'points: distance from the surface, mm (NOT the accuracy); grey: not used')]
    if content.covariance is not None:
        scales.append(scale_bar(colours.ERROR, colours.max_error(limits),
                                'bone: 95 % of the errors are smaller, mm; line: border of the '
                                'zone', limits.max_error))
    return ''.join(scales)


def _plots(content: ReportContent) -> str:
    parts = {'When the points were collected': (
                 time_line(content), 'A bar is a stroke, coloured by its RMS residual; '
                 'blue lines: landmarks, orange lines: verification points.'),
             'Residuals in the order of the points': (
                 residual_plot(content), 'In mm, outside positive, on a fixed scale. They show how '
                 'well the points fit, NOT how accurate the pose is. A trend indicates drift or a '
                 'wrong model.')}
    return ''.join(f'<section class="wide"><h2>{heading}</h2>{plot}<p class="note">{note}</p>'
                   '</section>' for heading, (plot, note) in parts.items() if plot)


def asset(name: str) -> str:
    """Return a file of this package: a style, a script or a template."""
    return files(__package__).joinpath(name).read_text(encoding='utf-8')
