# SPDX-License-Identifier: Apache-2.0
"""Test the reference implementation of the point-to-triangle distance."""

from __future__ import annotations

import numpy as np
from exact import distances


def test_distances_to_face_edge_and_corner() -> None:
    triangle = 0.01 * np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    points = 0.01 * np.array([[0.2, 0.2, 0.5], [0.5, -0.3, 0.0], [-0.3, -0.4, 0.0],
                              [1.0, 1.0, 0.0]])
    np.testing.assert_allclose(distances(points, triangle),
                               0.01 * np.array([0.5, 0.3, 0.5, np.sqrt(0.5)]))
