# SPDX-License-Identifier: Apache-2.0
"""The colour scales of points and bone."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.visualization import colours


def lightness(shades: np.ndarray) -> np.ndarray:
    """Return the relative luminance, which is independent of colour blindness."""
    linear = np.where(shades <= 0.04045, shades / 12.92, ((shades + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ [0.2126, 0.7152, 0.0722])


def test_a_scale_is_clipped_at_its_limit() -> None:
    shades = colours.on_scale(np.array([0.0, 0.002, 5.0]), colours.RESIDUAL, 0.002)
    assert shades[0] == pytest.approx(colours.rgb(colours.RESIDUAL[0]))
    assert shades[1] == pytest.approx(colours.rgb(colours.RESIDUAL[-1]))
    assert shades[2] == pytest.approx(shades[1])


def test_points_that_are_not_inliers_are_grey() -> None:
    shades = colours.residual_colours(np.array([0.0, -0.002, 0.0, np.nan]),
                                      np.array([1.0, 1.0, 0.5, 1.0]), LimitsConfig(max_sigma=0.002))
    assert shades[0] == pytest.approx(colours.rgb(colours.RESIDUAL[0]))
    assert shades[1] == pytest.approx(colours.rgb(colours.RESIDUAL[-1]))    # of either sign
    assert shades[2:] == pytest.approx(np.tile(colours.rgb(colours.UNUSED), (2, 1)))


def test_the_bone_darkens_with_the_expected_error() -> None:
    limits = LimitsConfig(max_error=0.5)
    shades = colours.error_colours(np.linspace(0.0, 1.0, 20), limits)
    assert (np.diff(lightness(shades)) < 0.0).all()
    assert lightness(shades[:1])[0] > 5.0 * lightness(shades[-1:])[0]
    # a point on the bone stands out from bone of small error
    point, bone = (lightness(colours.rgb(scale[0])[None])[0]
                   for scale in (colours.RESIDUAL, colours.ERROR))
    assert (bone + 0.05) / (point + 0.05) > 4.5     # contrast of text to be read (WCAG 2.1)
