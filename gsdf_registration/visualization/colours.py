# SPDX-License-Identifier: Apache-2.0
"""
Colours with the same meaning in every picture, distinguishable with colour blindness.

Points range from blue (on the surface) to red, the bone from its own colour (small error) to
purple, and places to touch next are green. The three differ in lightness as well as in hue. A scale
ends at the limit at which a registration is refused, or at twice that.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.result import INLIER_WEIGHT
from gsdf_registration.common.rigid import Array

RESIDUAL = ('#08408f', '#3e9bcb', '#f0d264', '#ea7a1f', '#b3120f')  # zero ... the limit and more
ERROR = ('#ebe3d2', '#c5a5cf', '#86419c', '#531178')                # zero ... the limit and more
UNUSED = '#8a8f94'      # points that are not inliers
BORDER = '#1b1f24'      # of the zone
NEXT = '#00a676'        # places to touch next
ERROR_SCALE = 2.0       # end of the scale of the error, in limits: the border is in its middle


def rgb(colour: str) -> Array:
    """Return '#rrggbb' as (3,) float in [0, 1]."""
    return np.array([int(colour[i:i + 2], 16) for i in (1, 3, 5)]) / 255.0


def on_scale(values: Array, scale: tuple[str, ...], limit: float) -> Array:
    """Return the colours (..., 3) of ``values`` (...) on a scale from zero to ``limit``."""
    places = np.linspace(0.0, limit, len(scale))
    return np.stack([np.interp(values, places, channel)
                     for channel in np.array([rgb(colour) for colour in scale]).T], axis=-1)


def max_residual(limits: LimitsConfig) -> float:
    """Return the end of the scale of the residuals, m."""
    return limits.max_sigma


def max_error(limits: LimitsConfig) -> float:
    """Return the end of the scale of the error, m; the border of the zone is in its middle."""
    return ERROR_SCALE * limits.max_error


def error_colours(errors: Array, limits: LimitsConfig) -> Array:
    """Return the colours (..., 3) of the bone for errors (...), m (95 %)."""
    return on_scale(errors, ERROR, max_error(limits))


def residual_colours(residuals: Array, weights: Array, limits: LimitsConfig) -> Array:
    """
    Return the colours (n, 3) of points by their distance from the surface; grey if not used.

    Parameters
    ----------
    residuals : (n,) float, m
        Signed; NaN if unknown.
    weights : (n,) float, in [0, 1]
        A point with a weight of 0.5 or less is not used.
    limits : LimitsConfig

    """
    used = np.isfinite(residuals) & (weights > INLIER_WEIGHT)
    known = np.where(used, np.abs(residuals), 0.0)
    return np.where(used[:, None], on_scale(known, RESIDUAL, max_residual(limits)), rgb(UNUSED))
