# SPDX-License-Identifier: Apache-2.0
"""Test exposed patches and geodesics on them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from exact import distances
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.result import InputError
from gsdf_registration.simulation.patch import (
    FACING,
    exposed_patch,
    stroke_over,
    walk,
    whole_surface,
)

CUBE = trimesh.creation.box((2.0, 2.0, 2.0))
BALL = trimesh.creation.icosphere(subdivisions=3)


def straight(surface: trimesh.Trimesh, start: np.ndarray, heading: np.ndarray, length: float,
             samples: int) -> np.ndarray:
    """Follow a geodesic on a closed surface from ``start`` in the direction ``heading``."""
    patch = whole_surface(np.asarray(surface.vertices), np.asarray(surface.faces))
    face = int(np.argmin(np.linalg.norm(patch.corners.mean(axis=1) - start, axis=1)))
    edge = patch.corners[face, 1] - patch.corners[face, 0]
    angle = np.arctan2(np.cross(edge, heading) @ patch.normals[face], edge @ heading)
    return walk(patch, start[None], np.array([face]), np.array([angle]),
                np.zeros(samples, dtype=np.int64), np.full(samples, length), np.zeros(samples))[0]


def test_geodesic_around_a_cube() -> None:
    start = np.array([0.1, 0.05, 1.0])
    points = straight(CUBE, start, np.array([1.0, 0.0, 0.0]), 1.0, 9)
    np.testing.assert_allclose(points[1], [1.0, 0.05, 0.9], atol=1e-12)
    np.testing.assert_allclose(points[3], [0.9, 0.05, -1.0], atol=1e-12)
    # back at the start, after the girth of the cube
    np.testing.assert_allclose(points[8], start, atol=1e-12)


def test_geodesic_on_a_sphere_is_nearly_a_great_circle() -> None:
    start = BALL.triangles_center[200]
    points = straight(BALL, start, np.cross(start, [0.3, 0.2, 1.0]), 0.02, 200)
    normal = np.linalg.svd(points)[2][2]
    assert np.abs(points @ normal).max() < 0.03


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_walk_stays_on_the_exposed_patch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = 0.03 * np.asarray(BALL.vertices), np.asarray(BALL.faces)
    patch = exposed_patch(vertices, faces, (0.0, 0.0, 0.03), 0.025)
    starts, first = patch.random_points(3, rng)
    strokes = np.repeat(np.arange(3), 40)
    steps = rng.uniform(0.0, 0.004, 120)
    headings, turns = rng.uniform(0.0, 6.3, 3), rng.normal(size=120)
    points, triangles = walk(patch, starts, first, headings, strokes, steps, turns)
    np.testing.assert_allclose(points[::40], starts)
    assert distances(points, patch.corners).max() < 1e-12
    strides = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert (strides <= steps[1:] + 1e-12)[strokes[1:] == strokes[:-1]].all()
    assert np.linalg.norm(points - [0.0, 0.0, 0.03], axis=1).max() < 0.03


def test_exposed_patch_is_near_facing_and_connected(
        hip_surface: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = hip_surface
    approach = np.array([0.745, 0.3, -0.596])
    patch = exposed_patch(vertices, faces, (0.0, 0.0, 0.0), 0.04, approach)
    assert (np.linalg.norm(patch.corners.mean(axis=1), axis=1) < 0.04).all()
    assert (patch.normals @ patch.approach > FACING).all()
    mesh = trimesh.Trimesh(patch.corners.reshape(-1, 3),
                           np.arange(3 * len(patch.corners)).reshape(-1, 3))
    assert mesh.body_count == 1


def test_default_approach_is_the_normal_at_the_centre() -> None:
    patch = exposed_patch(np.asarray(BALL.vertices), np.asarray(BALL.faces), (0.0, 1.1, 0.0), 0.5)
    assert patch.approach @ [0.0, 1.0, 0.0] > 0.98


def test_rejects_a_region_without_bone() -> None:
    with pytest.raises(InputError, match='too little bone'):
        exposed_patch(np.asarray(BALL.vertices), np.asarray(BALL.faces), (9.0, 0.0, 0.0), 0.5)


def test_random_points_are_uniform() -> None:
    patch = whole_surface(np.asarray(CUBE.vertices), np.asarray(CUBE.faces))
    points, faces = patch.random_points(6000, np.random.default_rng(0))
    assert np.abs(points.mean(axis=0)).max() < 0.06
    np.testing.assert_allclose(np.abs(points).max(axis=1), 1.0)
    np.testing.assert_allclose(np.bincount(faces, minlength=12), 500, atol=90)


def test_a_stroke_over_a_place_has_it_in_its_middle() -> None:
    vertices, faces = np.asarray(BALL.vertices), np.asarray(BALL.faces)
    place, step = np.array([0.1, 0.2, 0.97]), 0.02
    patch = exposed_patch(vertices, faces, place, 0.8)
    tips = stroke_over(patch, place, 30, step, 1.0, np.random.default_rng(0))
    assert tips.shape == (30, 3) and distances(tips, patch.corners, 0.3).max() < 1e-9
    steps = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    assert steps.max() <= step * (1.0 + 1e-9) and np.median(steps) > 0.9 * step
    away = np.linalg.norm(tips - place, axis=1)
    nearest = np.linalg.norm(patch.corners.mean(axis=1) - place, axis=1).min()
    assert away.argmin() in (14, 15, 16) and away.min() < nearest + step
    assert away[[0, -1]].min() > 0.2 and away.max() < nearest + 15.5 * step
