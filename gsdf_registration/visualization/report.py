# SPDX-License-Identifier: Apache-2.0
"""The report of a registration: one HTML file that needs no network."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping
from importlib.resources import files
from string import Template

import numpy as np

from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.visualization.report_table import sections

ACCURACY_NOTE = (
    'The <b>predicted TRE</b> is the expected error at a place on the bone. It follows from the '
    'noise of the points and from their distribution. The <b>residual</b> is the fit: how closely '
    'the points lie on the model. <b>It is NOT the accuracy</b>: points on a small or regular area '
    'can fit perfectly in the wrong place. Verify the pose on the bone with points that were not '
    'used.')
RESIDUAL_HEADING = (
    '<h2>Residuals in the order of the points: how well they fit, NOT how accurate the pose is. '
    'A trend along the sequence indicates drift or a wrong model.</h2>\n')
REFUSED_NOTE = (
    'There is <b>no pose</b>. Only the points are shown, in the tracker frame. The numbers in the '
    'table belong to the best candidate, which was rejected and must not be used.')


def require_plotly() -> None:
    """Raise an `InputError` that says what to install if plotly is missing."""
    try:
        import plotly.graph_objects  # noqa: F401
    except ImportError:
        raise InputError('a report needs plotly, which is not installed: '
                         "pip install 'gsdf_registration[report]'") from None


def write_report(path: str | os.PathLike[str], result: RegistrationResult, field: Field | None,
                 points_tracker: Array, *, title: str, about: Mapping[str, str]) -> None:
    """
    Write the report of a registration as one self-contained HTML file.

    Parameters
    ----------
    path : str or path
        The file; an existing one is replaced.
    result : RegistrationResult
        Accepted or refused.
    field : Field or None
        Of the bone; None if it could not be built, which is a refusal.
    points_tracker : (n, 3) float, metres, tracker frame
        The points in the order of ``result.residuals_m``; points that are not finite are not drawn.
    title : str
        What was registered, in a few words.
    about : mapping of str to str
        Further rows of the table: inputs, their hashes, times.

    Raises
    ------
    InputError
        If plotly is not installed or the file cannot be written.

    """
    require_plotly()
    from msg_adapters.files import write_atomically
    write_atomically(path, _page(result, _plots(result, field, np.asarray(points_tracker)),
                                 title, about))


def _plots(result: RegistrationResult, field: Field | None, points: Array) -> list[str]:
    """Return the plots as HTML; the first one contains the script of plotly."""
    from gsdf_registration.visualization.report_residuals import residual_figure
    from gsdf_registration.visualization.report_scene import bone_scene, tracker_scene
    if result.T_bone_tracker is None or field is None:
        figures = {'scene': tracker_scene(points)}
    else:
        figures = {'scene': bone_scene(result, field, points)}
        if result.residuals_m is not None:
            figures['residuals'] = residual_figure(result)
    return [figure.to_html(full_html=False, include_plotlyjs=number == 0, div_id=name,
                           config={'displaylogo': False, 'responsive': True})
            for number, (name, figure) in enumerate(figures.items())]


def _page(result: RegistrationResult, plots: list[str], title: str,
          about: Mapping[str, str]) -> str:
    outcome = 'Registered' if result.success else f'Refused: {result.reason}'
    template = Template(files(__package__).joinpath('report.html').read_text(encoding='utf-8'))
    return template.substitute(
        title=html.escape(title), outcome=html.escape(outcome),
        kind='good' if result.success else 'bad', message=html.escape(result.message),
        note=ACCURACY_NOTE if result.success else REFUSED_NOTE, table=_table(result, about),
        scene=plots[0], more=''.join(RESIDUAL_HEADING + plot for plot in plots[1:]))


def _table(result: RegistrationResult, about: Mapping[str, str]) -> str:
    lines = []
    for heading, rows in sections(result, about).items():
        lines.append(f'<tr><th colspan="2" scope="colgroup">{html.escape(heading)}</th></tr>')
        lines += [f'<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>'
                  for name, value in rows]
    return '\n'.join(lines)
