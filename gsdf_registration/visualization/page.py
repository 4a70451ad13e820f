# SPDX-License-Identifier: Apache-2.0
"""The page: headline, what it means, table, pictures."""

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
from gsdf_registration.visualization.table import sections

ACCURACY = (
    'The <b>predicted TRE</b> is the error to expect at a place on the bone, from the noise of the '
    'points and from where they were taken. The <b>residual</b> is the fit: how closely the points '
    'lie on the model. <b>It is NOT the accuracy</b>; points on a small or regular region can fit '
    'perfectly in the wrong place. Verify on the bone with points that were not used.')
RESIDUALS = (
    '<h2>Residuals in the order of the points: how well they fit, NOT how accurate the pose is. '
    'Patterns along the sequence tell of drift or of a wrong model.</h2>\n')
REFUSED = (
    'There is <b>no pose</b>. The points are shown alone, in the frame they were taken in. '
    'Numbers in the table are those of the best solution found, which must not be used.')


def require_plotly() -> None:
    """Raise an `InputError` that says what to install if the pictures cannot be drawn."""
    try:
        import plotly.graph_objects  # noqa: F401
    except ImportError:
        raise InputError('a report needs plotly, which is not installed: '
                         "pip install 'gsdf_registration[report]'") from None


def write_report(path: str | os.PathLike[str], result: RegistrationResult, field: Field | None,
                 points_tracker: Array, *, title: str, about: Mapping[str, str]) -> None:
    """
    Write a registration as one self-contained HTML file.

    Parameters
    ----------
    path : str or path
        The file; one that is there is replaced.
    result : RegistrationResult
        A pose or a refusal.
    field : Field or None
        Of the bone; None when it could not be built, which is a refusal.
    points_tracker : (n, 3) float, metres, tracker frame
        The points given, in the order of ``result.residuals_m``; what is not finite is not drawn.
    title : str
        What was registered, in a few words.
    about : mapping of str to str
        What else a reader must know, a row each: inputs, their hashes, times.

    Raises
    ------
    InputError
        When plotly is not installed or the file cannot be written.

    """
    require_plotly()
    from msg_adapters.files import write_atomically
    write_atomically(path, _page(result, _pictures(result, field, np.asarray(points_tracker)),
                                 title, about))


def _pictures(result: RegistrationResult, field: Field | None, points: Array) -> list[str]:
    """Return the pictures as HTML; the first one brings plotly's script along."""
    from gsdf_registration.visualization.residuals import residual_figure
    from gsdf_registration.visualization.scene import bone_scene, tracker_scene
    if result.T_bone_tracker is None or field is None:
        figures = {'scene': tracker_scene(points)}
    else:
        figures = {'scene': bone_scene(result, field, points)}
        if result.residuals_m is not None:
            figures['residuals'] = residual_figure(result)
    return [figure.to_html(full_html=False, include_plotlyjs=number == 0, div_id=name,
                           config={'displaylogo': False, 'responsive': True})
            for number, (name, figure) in enumerate(figures.items())]


def _page(result: RegistrationResult, pictures: list[str], title: str,
          about: Mapping[str, str]) -> str:
    verdict = 'Registered' if result.success else f'Refused: {result.reason}'
    template = Template(files(__package__).joinpath('page.html').read_text(encoding='utf-8'))
    return template.substitute(
        title=html.escape(title), verdict=html.escape(verdict),
        kind='good' if result.success else 'bad', message=html.escape(result.message),
        note=ACCURACY if result.success else REFUSED, table=_table(result, about),
        scene=pictures[0], more=''.join(RESIDUALS + picture for picture in pictures[1:]))


def _table(result: RegistrationResult, about: Mapping[str, str]) -> str:
    lines = []
    for heading, rows in sections(result, about).items():
        lines.append(f'<tr><th colspan="2" scope="colgroup">{html.escape(heading)}</th></tr>')
        lines += [f'<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>'
                  for name, value in rows]
    return '\n'.join(lines)
