# SPDX-License-Identifier: Apache-2.0
"""Write what the options ask for: the JSON document and the HTML report."""

from __future__ import annotations

import datetime
import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gsdf_registration.common.command_line import spinner

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.visualization.report_content import ReportContent

EARLIEST, LATEST = 3e8, 4e9    # s since 1970: others are the uptime of a tracker


def require_report(path: str | None) -> None:
    """Raise `InputError` before any work is done if a library for ``--report`` is missing."""
    if path is not None:
        from gsdf_registration.visualization import require_pillow
        require_pillow()


def write_report(path: str | None, content: ReportContent) -> None:
    """Write the HTML report if ``--report`` was given."""
    if path is not None:
        from gsdf_registration.visualization import write_report as write
        with spinner('writing the report'):
            write(path, content)


def about_inputs(model: str, points: str, document: Mapping[str, Any]) -> dict[str, str]:
    """Return the rows of the report on model and points, with the hashes of a JSON document."""
    hashes = {key.replace('_sha256', ' SHA-256'): sha256
              for key, sha256 in document['inputs'].items() if sha256}
    load = document['timing_s']['load']
    times = {} if load is None else {'time to load': f'{load:.2f} s'}
    return {'model': model, 'points': points, **hashes, **times}


def day_of(stamps: Array) -> str:
    """Return the date and time (UTC) of the first of the stamps, s since 1970; empty if unknown."""
    if not len(stamps) or not EARLIEST < stamps[0] < LATEST:
        return ''
    time = datetime.datetime.fromtimestamp(float(stamps[0]), datetime.timezone.utc)
    return f'{time:%Y-%m-%d %H:%M} UTC'


def write_json(path: str | None, document: Any) -> None:
    """Write a document if ``--json`` was given; NaN raises ValueError: JSON has none."""
    if path is None:
        return
    text = json.dumps(document, indent=1, allow_nan=False) + '\n'
    if path == '-':
        sys.stdout.write(text)
        return
    from msg_adapters.files import write_atomically
    write_atomically(path, text)
