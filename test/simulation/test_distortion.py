# SPDX-License-Identifier: Apache-2.0
"""The smooth distortion of positions and orientations."""

from __future__ import annotations

import numpy as np

from gsdf_registration.simulation.distortion import Distortion


def test_displacement_has_the_given_length() -> None:
    rng = np.random.default_rng(0)
    lengths = [np.linalg.norm(Distortion.random(0.002, rng).displacement(
        rng.uniform(-1.0, 1.0, (200, 3))), axis=1) for _ in range(50)]
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(lengths))), 0.002, rtol=0.1)


def test_rotation_is_half_the_curl_of_the_displacement() -> None:
    rng, h = np.random.default_rng(1), 1e-5
    field, places = Distortion.random(0.002, rng), rng.uniform(-1.0, 1.0, (20, 3))
    slopes = np.stack([(field.displacement(places + h * e) - field.displacement(places - h * e))
                       / (2.0 * h) for e in np.eye(3)], axis=2)     # by position
    curl = np.stack([slopes[:, 2, 1] - slopes[:, 1, 2], slopes[:, 0, 2] - slopes[:, 2, 0],
                     slopes[:, 1, 0] - slopes[:, 0, 1]], axis=1)
    np.testing.assert_allclose(field.rotation(places), 0.5 * curl, atol=1e-9)
