# SPDX-License-Identifier: Apache-2.0
"""
Points as lines of JSON, one point each, converted in parts: many points take little memory.

Points are the rows of a structured array; NaN is null in JSON and means unknown.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator

import numpy as np

# Points converted at a time: some milliseconds, in which Python does nothing else
PART = 1000
INDENT = '    '


def lines_of(points: np.ndarray) -> Iterator[str]:
    """
    Yield the text of points (n,), a part at a time: each on a new line, with commas between them.

    Raises
    ------
    ValueError
        If a value is infinite.

    """
    for name in points.dtype.names or ():
        if np.isinf(points[name]).any():
            raise ValueError(f'column {name} contains an infinite value')
    for first in range(0, len(points), PART):
        rows = json.dumps(points[first:first + PART].tolist())[1:-1].replace('NaN', 'null')
        yield (',\n' if first else '\n') + INDENT + rows.replace('], [', f'],\n{INDENT}[')


def points_of(lines: Iterable[bytes], columns: list[str]) -> np.ndarray:
    """
    Return the points (n,) of such lines; all columns are float64.

    Raises
    ------
    ValueError, TypeError
        If the lines are damaged, or have not these columns.

    """
    lines, parts = iter(lines), [np.empty((0, len(columns)))]
    while part := b''.join(itertools.islice(lines, PART)):
        rows = np.array(json.loads(b'[' + part.rstrip(b',\n') + b']'), np.float64)
        if rows.ndim != 2 or rows.shape[1] != len(columns):
            raise ValueError(f'the points are not rows of {len(columns)} numbers')
        parts.append(rows)
    return np.concatenate(parts).view(np.dtype([(name, '<f8') for name in columns])).reshape(-1)
