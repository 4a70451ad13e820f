# SPDX-License-Identifier: Apache-2.0
"""
Rows of numbers in JSON: exact, and written in a hundredth of the time that text takes.

The rows are those of a structured array.  In JSON they are ``{"columns": [["x", "<f8"], ...],
"rows": "..."}``, with the bytes of the array in base64; NaN means unknown.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np


def packed(value: Any) -> dict[str, Any]:
    """Return a structured array as plain values; to be used as ``default`` of a JSON encoder."""
    if not isinstance(value, np.ndarray) or value.dtype.names is None:
        raise TypeError(f'{type(value).__name__} is not plain')
    return {'columns': [list(column) for column in value.dtype.descr],
            'rows': base64.b64encode(value.tobytes()).decode()}


def unpacked(value: dict[str, Any]) -> Any:
    """
    Return the structured array that was packed; to be used as ``object_hook`` of a JSON decoder.

    Any other ``value`` is returned as it is.  Raises ValueError or TypeError if it is damaged.
    """
    if value.keys() != {'columns', 'rows'}:
        return value
    columns = np.dtype([(name, kind) for name, kind in value['columns']])
    return np.frombuffer(base64.b64decode(value['rows'], validate=True), columns)
