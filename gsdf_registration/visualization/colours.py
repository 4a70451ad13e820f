# SPDX-License-Identifier: Apache-2.0
"""
What colours mean, the same in every picture; told apart by the colour-blind too.

Points run from blue (on the surface) to red, the bone from its own colour (error small) to purple,
what to touch next is green; all three differ in lightness as well as in hue. The scales end where
a registration would be refused for it, or at twice that.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.result import ON_BONE
from gsdf_registration.common.rigid import Array

RESIDUAL = ('#08408f', '#3e9bcb', '#f0d264', '#ea7a1f', '#b3120f')  # none ... the limit and more
ERROR = ('#ebe3d2', '#c5a5cf', '#86419c', '#531178')                # none ... the limit and more
UNUSED = '#8a8f94'      # points that do not bear the pose
NEXT = '#00a676'        # what to touch next


def rgb(colour: str) -> Array:
    """Return '#rrggbb' as (3,) float in [0, 1]."""
    return np.array([int(colour[i:i + 2], 16) for i in (1, 3, 5)]) / 255.0


def on_scale(values: Array, scale: tuple[str, ...], limit: float) -> Array:
    """Return the colours (..., 3) of ``values`` (...) on a scale from zero to ``limit``."""
    places = np.linspace(0.0, limit, len(scale))
    return np.stack([np.interp(values, places, channel)
                     for channel in np.array([rgb(colour) for colour in scale]).T], axis=-1)


def most_residual(limits: LimitsConfig) -> float:
    """Return where the scale of the residuals ends, m."""
    return limits.max_sigma


def most_error(limits: LimitsConfig) -> float:
    """Return where the scale of the error to expect ends, m."""
    return 2.0 * limits.max_predicted_tre


def error_colours(errors: Array, limits: LimitsConfig) -> Array:
    """Return the colours (..., 3) of the bone where so much error is to be expected, m (...)."""
    return on_scale(errors, ERROR, most_error(limits))


def residual_colours(residuals: Array, weights: Array, limits: LimitsConfig) -> Array:
    """
    Return the colours (n, 3) of points: by how far they are off the surface, grey if not used.

    Parameters
    ----------
    residuals : (n,) float, m, of either sign; NaN where unknown
    weights : (n,) float, in [0, 1]; a point of 0.5 or less does not bear the pose
    limits : LimitsConfig

    """
    used = np.isfinite(residuals) & (weights > ON_BONE)
    known = np.where(used, np.abs(residuals), 0.0)
    return np.where(used[:, None], on_scale(known, RESIDUAL, most_residual(limits)),
                    rgb(UNUSED))
