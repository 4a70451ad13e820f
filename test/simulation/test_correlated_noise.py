# SPDX-License-Identifier: Apache-2.0
"""Noise that is correlated in time has variance one from the first sample on, and its memory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.correlated_noise import (
    correlated_noise,
    unevenly_correlated_noise,
)

MEMORY = 5.0
RUNS = 20_000


def evenly(rng: np.random.Generator) -> Array:
    return correlated_noise((8, RUNS), MEMORY, rng)


def unevenly(rng: np.random.Generator) -> Array:
    return unevenly_correlated_noise(np.arange(8.0), RUNS, MEMORY, rng)


@pytest.mark.parametrize('make', [evenly, unevenly])
def test_the_noise_is_stationary_and_correlated(
        make: Callable[[np.random.Generator], Array]) -> None:
    noise = make(np.random.default_rng(0))
    np.testing.assert_allclose(noise.var(axis=1), 1.0, atol=0.05)
    for lag in (1, 4):
        for row in range(8 - lag):
            assert np.mean(noise[row] * noise[row + lag]) == pytest.approx(
                np.exp(-lag / MEMORY), abs=0.03)


def test_a_pause_ends_the_correlation() -> None:
    stamps = np.array([0.0, 1.0, 1000.0])
    noise = unevenly_correlated_noise(stamps, RUNS, MEMORY, np.random.default_rng(0))
    assert abs(np.mean(noise[1] * noise[2])) < 0.03
