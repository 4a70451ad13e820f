# SPDX-License-Identifier: Apache-2.0
"""Landmarks are checked when they are made."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.result import InputError

PLACES = np.arange(9.0).reshape(3, 3)


@pytest.mark.parametrize(('values', 'words'), [
    ((PLACES, PLACES[:2]), 'one touched point for each'),
    ((PLACES[0], PLACES[0]), 'one touched point for each'),
    ((PLACES, PLACES + np.nan), 'not finite'),
    ((PLACES, PLACES - 3.7e28), 'not finite'),
    ((PLACES, 'abc'), 'array of numbers'),
    ((PLACES, PLACES, [0.001]), 'one standard deviation each'),
    ((PLACES, PLACES, [0.001, -0.001, 0.0]), 'must be 0'),
    ((PLACES, PLACES, [0.001, np.inf, 0.0]), 'must be 0'),
    ((PLACES, PLACES, [0.001, 'x', 0.0]), 'array of numbers'),
    ((PLACES, PLACES, None, ['a']), '3 landmarks have 1 names'),
])
def test_invalid_landmarks_are_refused_with_a_sentence(values: tuple[Any, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Landmarks.of(*values)


def test_landmarks_without_names_are_numbered_and_not_measured() -> None:
    marks = Landmarks.of(PLACES, PLACES + 1.0)
    assert marks.names == ('1', '2', '3') and len(marks) == 3
    assert not len(marks.measured) and not len(NO_LANDMARKS)


@given(st.lists(st.sampled_from([0.0, 0.001, 0.002]), min_size=3, max_size=3))
def test_measured_are_those_with_a_standard_deviation(sigmas: list[float]) -> None:
    marks = Landmarks.of(PLACES, PLACES + 1.0, sigmas, 'abc')
    assert marks.measured.names == tuple(
        name for name, sigma in zip('abc', sigmas) if sigma > 0.0)
    assert marks.rows([0, 1, 2]).equals(marks)
    assert marks.equals(Landmarks.of(PLACES, PLACES + 1.1, sigmas, 'abc')) is False
