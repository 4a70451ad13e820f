# SPDX-License-Identifier: Apache-2.0
"""The differences of two results as rows, for text and for a page."""

from __future__ import annotations

import math
import os

from gsdf_registration.common.formatting import format_error
from gsdf_registration.registration.result_comparison import Comparison
from gsdf_registration.visualization.report import page, tables
from gsdf_registration.visualization.report_table import Rows, setting, whole_bone

UNKNOWN = 'not known'


def sections(comparison: Comparison, names: tuple[str, str]) -> dict[str, Rows]:
    """Return the rows (name, value) by heading; ``names`` of the files A and B."""
    outcomes = [f'{file}: {outcome}' for file, outcome in zip(names, comparison.outcomes)]
    pose = [(f'at {name}' if name else name, f'{1e3 * moved:.2f} mm')
            for name, moved in comparison.displacement_m.items()]
    if comparison.rotation is not None:
        pose.append(('rotation', f'{math.degrees(comparison.rotation):.3f} deg'))
    known = {
        'Results': list(zip('AB', outcomes)),
        'Remarks': [(str(number), text) for number, text in enumerate(comparison.remarks, 1)],
        'Difference of the poses (TRE of B if A were true)': pose,
        'Predicted TRE, A and B': [(whole_bone(name), ' and '.join(map(_error, pair)))
                                   for name, pair in comparison.predicted_tre_m.items()
                                   if pair != (None, None)],
        'Settings that differ, A and B': [
            (name, f'{setting(a)}  |  {setting(b)}')
            for name, (a, b) in comparison.settings.items()] or [('none', '')]}
    return {heading: rows for heading, rows in known.items() if rows}


def comparison_text(comparison: Comparison, names: tuple[str, str]) -> str:
    """Return the differences as text."""
    return '\n'.join('\n'.join([heading, *(f'  {name:<32} {value}'.rstrip()
                                           for name, value in rows)])
                     for heading, rows in sections(comparison, names).items())


def write_comparison(path: str | os.PathLike[str], comparison: Comparison,
                     names: tuple[str, str]) -> None:
    """Write the differences as an HTML page; replace an existing one."""
    from msg_adapters.files import write_atomically
    title = f'{names[0]} and {names[1]}'
    write_atomically(path, page(title, '<h1>Comparison of two registrations</h1>'
                                f'<div>{tables(sections(comparison, names))}</div>'))


def _error(value: float | None) -> str:
    return UNKNOWN if value is None else format_error(value)
