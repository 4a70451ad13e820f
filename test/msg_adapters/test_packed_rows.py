# SPDX-License-Identifier: Apache-2.0
"""Packed rows are the rows, to the bit."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from msg_adapters.packed_rows import packed, unpacked

ROWS = np.array([(1, -0.1, np.nan), (2**31 - 1, 1e-300, 1.7e9 + 1e-7)],
                [('stroke', '<i4'), ('x', '<f8'), ('stamp', '<f8')])


@pytest.mark.parametrize('rows', [ROWS, ROWS[:0], ROWS[::-1]])
def test_rows_survive_json(rows: np.ndarray) -> None:
    text = json.dumps({'event': [{'fit': rows, 'x': 1}]}, default=packed, allow_nan=False)
    found = json.loads(text, object_hook=unpacked)['event'][0]
    assert found['x'] == 1 and found['fit'].dtype == rows.dtype
    assert found['fit'].tobytes() == rows.tobytes()


@pytest.mark.parametrize('value', [object(), np.zeros(3), np.float64(1.0).dtype])
def test_packs_nothing_else(value: Any) -> None:
    with pytest.raises(TypeError, match='is not plain'):
        json.dumps(value, default=packed)


@pytest.mark.parametrize('change', [
    {'rows': 'AAAA'}, {'rows': '!' + packed(ROWS)['rows'][1:]}, {'rows': 1}, {'columns': 1},
    {'columns': [['x']]}, {'columns': [['x', 'O'], ['y', 'O'], ['z', '<i4']]},
    {'columns': [['x', '<f8'], ['x', '<f8'], ['z', '<i4']]}])
def test_rejects_damaged_rows(change: dict[str, Any]) -> None:
    with pytest.raises((ValueError, TypeError)):
        unpacked(packed(ROWS) | change)
