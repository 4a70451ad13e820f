# SPDX-License-Identifier: Apache-2.0
"""Write what the options ask for: the JSON document and the HTML report."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gsdf_registration.common.result import RegistrationResult
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field


def require_report(path: str | None) -> None:
    """Raise `InputError` before any work is done if a library for ``--report`` is missing."""
    if path is not None:
        from gsdf_registration.visualization import require_plotly
        require_plotly()


def write_report(path: str | None, result: RegistrationResult, field: Field | None, points: Array,
                 document: dict[str, Any], about: Mapping[str, str]) -> None:
    """
    Write the HTML report if ``--report`` was given.

    Parameters
    ----------
    path : of the report; None: write nothing
    result, field : the registration and the bone
    points : (n, 3) m, those that were registered
    document : the result as JSON
    about : rows on the inputs, the model and the points first

    """
    if path is None:
        return
    from gsdf_registration.visualization import write_report as write
    model, touched = (Path(name).name for name in list(about.values())[:2])
    hashes = {key.replace('_sha256', ' SHA-256'): sha256
              for key, sha256 in document['inputs'].items() if sha256}
    times = {'time to load': f'{document["timing_s"]["load"]:.2f} s'}
    write(path, result, field, points, title=f'{model} from {touched}',
          about={**about, **hashes, **times})


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
