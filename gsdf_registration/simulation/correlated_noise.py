# SPDX-License-Identifier: Apache-2.0
"""Noise of variance one that is correlated in time: an autoregressive process of first order."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from gsdf_registration.common.rigid import Array


def correlated_noise(shape: int | tuple[int, int], memory: float,
                     rng: np.random.Generator) -> Array:
    """
    Return noise of a ``shape`` (n,) or (n, k), stationary from the first sample on.

    ``memory``: number of samples over which each column is correlated.
    """
    keep = np.exp(-1.0 / memory)
    noise = rng.normal(size=shape) * np.sqrt(1.0 - keep * keep)
    noise[:1] /= np.sqrt(1.0 - keep * keep)
    # not with scipy.signal, which takes half a second to import
    return np.array(list(accumulate(noise, lambda before, now: keep * before + now))).reshape(shape)


def unevenly_correlated_noise(stamps: Array, columns: int, memory: float,
                              rng: np.random.Generator) -> Array:
    """Return noise (n, columns) at ``stamps`` (n,), s; ``memory``: s."""
    keep = np.exp(-np.diff(stamps, prepend=stamps[:1]) / memory)
    noise = rng.normal(size=(len(stamps), columns))
    for i in range(1, len(stamps)):
        noise[i] = keep[i] * noise[i - 1] + np.sqrt(1.0 - keep[i]**2) * noise[i]
    return noise
