# SPDX-License-Identifier: Apache-2.0
"""Points of strokes and scattered outliers, without a bone."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import Array


def stroke(n: int, step: float = 3.5e-4, height: float = 0.0) -> Array:
    """Return points (n, 3), m, ``step`` apart on a curve, with the noise of a tracker."""
    s = step * np.arange(n)
    curve = np.column_stack([0.02 * np.cos(s / 0.02), 0.02 * np.sin(s / 0.02), height + 0.1 * s])
    return curve + 2e-4 * np.random.default_rng(n).normal(size=(n, 3))


def scattered(n: int) -> Array:
    """Return points (n, 3), m, uniform in a cube of 0.3 m."""
    return np.random.default_rng(1).uniform(-0.15, 0.15, (n, 3))
