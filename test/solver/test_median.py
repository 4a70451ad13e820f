# SPDX-License-Identifier: Apache-2.0
"""The in-place median, compared with numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.solver.median import median


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60))
@settings(deadline=None, max_examples=200)
def test_agrees_with_numpy(values: list[float]) -> None:
    x = np.array(values)
    assert median(x.copy()) == np.median(x)


@pytest.mark.parametrize('n', [1, 2, 1000, 1001])
def test_sorted_reversed_and_equal_values(n: int) -> None:
    x = np.arange(n, dtype=np.float64)
    for values in (x, x[::-1].copy(), np.full(n, 3.0), x % 2, np.abs(x - n / 2)):
        assert median(values.copy()) == np.median(values)


def test_only_reorders_the_values() -> None:
    x = np.random.default_rng(0).random(500)
    y = x.copy()
    median(y)
    np.testing.assert_array_equal(np.sort(y), np.sort(x))
