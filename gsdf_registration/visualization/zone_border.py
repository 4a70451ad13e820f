# SPDX-License-Identifier: Apache-2.0
"""The border of the zone on the bone: where the error equals the limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array


def border_segments(vertices: Array, faces: NDArray[np.int32], errors: Array,
                    limit: float) -> Array:
    """
    Return the border as line segments (k, 2, 3), m: linear interpolation within each triangle.

    Parameters
    ----------
    vertices : (n, 3) float, m
    faces : (m, 3) int
    errors : (n,) float, m
        At the vertices.
    limit : float, m

    """
    over = errors[faces] > limit
    count = over.sum(axis=1)
    crossed = (count == 1) | (count == 2)
    # two edges of a crossed triangle meet the border: those of the corner that differs
    alone = np.argmax(over[crossed] == (count[crossed] == 1)[:, None], axis=1)
    corners = faces[crossed][np.arange(len(alone))[:, None], (alone[:, None] + [0, 1, 2]) % 3]
    ends = []
    for other in (1, 2):
        a, b = corners[:, 0], corners[:, other]
        share = (limit - errors[a]) / (errors[b] - errors[a])
        ends.append(vertices[a] + share[:, None] * (vertices[b] - vertices[a]))
    return np.stack(ends, axis=1)


def border_pixels(inside: NDArray[np.bool_], visible: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """
    Return the pixels (h, w) of a picture on the border.

    Parameters
    ----------
    inside : (h, w) bool
        Whether the place that a pixel shows is in the zone.
    visible : (h, w) bool
        Whether a pixel shows a place on the bone.

    """
    border = np.zeros(inside.shape, dtype=bool)
    right = (inside[:, 1:] != inside[:, :-1]) & visible[:, 1:] & visible[:, :-1]
    below = (inside[1:] != inside[:-1]) & visible[1:] & visible[:-1]
    for differs, here, there in ((right, np.s_[:, 1:], np.s_[:, :-1]),
                                 (below, np.s_[1:], np.s_[:-1])):
        border[here] |= differs
        border[there] |= differs
    return border
