# SPDX-License-Identifier: Apache-2.0
"""Models of a bone as they come from a scan, compared with the bone."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.imperfect_models import CT, Scan, decimated, segmented

RADIUS = 0.012      # m
BOUNDS = np.array([[-RADIUS] * 3, [RADIUS] * 3])


def ball(points: Array) -> Array:
    """Return the signed distance to a ball."""
    return np.asarray(np.linalg.norm(points, axis=1) - RADIUS)


def errors_of(scan: Scan, seed: int = 0) -> Array:
    """Return the distance of each vertex of the segmented ball from its surface, m."""
    return ball(segmented(ball, BOUNDS, scan, np.random.default_rng(seed))[0])


def test_without_noise_and_error_of_the_threshold_a_segmentation_is_accurate() -> None:
    errors = errors_of(Scan(CT.voxel, CT.blur, 0.0, 0.0))
    assert np.abs(errors.mean()) < 5e-5     # blur makes a ball smaller by blur^2 / radius
    assert errors.std() < 3e-5


def test_the_error_of_the_threshold_dilates_or_erodes() -> None:
    means = [errors_of(CT, seed).mean() for seed in range(8)]
    assert max(means) > 5e-5 and min(means) < -5e-5
    assert np.abs(means).max() < 2.5e-4


def test_a_segmentation_has_local_errors_and_one_closed_body_with_outward_faces() -> None:
    vertices, faces = segmented(ball, BOUNDS, CT, np.random.default_rng(0))
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight and mesh.body_count == 1 and mesh.volume > 0.0
    assert 2e-5 < ball(vertices).std() < 2e-4


def test_the_same_seed_gives_the_same_segmentation() -> None:
    a, b = (segmented(ball, BOUNDS, CT, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1])


def test_a_decimated_model_has_few_faces_near_the_bone() -> None:
    pytest.importorskip('fast_simplification')
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    vertices, faces = decimated(sphere.vertices, sphere.faces, 500)
    assert 400 <= len(faces) <= 500
    assert np.abs(ball(vertices)).max() < 5e-4
