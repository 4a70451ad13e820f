# SPDX-License-Identifier: Apache-2.0
"""Find the pixels of a colour in a picture."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import colours


def has_colour(image: Array, colour: str) -> Array:
    """Return a mask (h, w) of the pixels of a colour at any brightness."""
    hue = colours.rgb(colour) / np.linalg.norm(colours.rgb(colour))
    shade = image / np.maximum(np.linalg.norm(image, axis=-1, keepdims=True), 1e-9)
    return np.asarray((shade @ hue > 0.99) & (image.min(axis=-1) < 0.9))
