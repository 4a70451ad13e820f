# SPDX-License-Identifier: Apache-2.0
"""Test the sampling of a field near the surface, far from it and outside the grid."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.result import InputError
from gsdf_registration.field import build_field
from gsdf_registration.field.sample import sample, sample_many
from gsdf_registration.mesh.bone import make_bone

RADIUS = 0.03
coordinate = st.one_of(st.floats(-0.06, 0.06), st.floats(-1e6, 1e6))


@pytest.fixture(scope='module')
def sphere():
    mesh = trimesh.creation.icosphere(5, RADIUS)
    return build_field(make_bone(mesh.vertices, mesh.faces), 0.001)


def directions(n):
    x = np.random.default_rng(0).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def test_distances_in_the_band_are_third_order_accurate(sphere):
    u = directions(5000)
    r = RADIUS + np.random.default_rng(1).uniform(-0.003, 0.003, 5000)
    d, g = sphere.sample(u * r[:, None])
    assert np.sqrt(np.mean((d - (r - RADIUS)) ** 2)) < 1.5e-5      # the facets alone: 1e-5
    assert (g * u).sum(axis=1).min() > 0.999


@pytest.mark.parametrize('far', [0.05, 0.3, 3.0, 1000.0])
def test_far_points_project_onto_the_surface(sphere, far):
    u = directions(500)
    d, g = sphere.sample(u * (RADIUS + far))
    # the distance is that to a surface point that is nearly the nearest one
    assert (d > far - 1e-4).all() and (d < 1.05 * far + 1e-4).all()
    back = u * (RADIUS + far) - d[:, None] * g
    assert np.abs(np.linalg.norm(back, axis=1) - RADIUS).max() < 0.002 + 1e-4 * far


def test_distances_are_negative_inside(sphere):
    d, _ = sphere.sample(directions(200) * np.linspace(0.0, 0.9 * RADIUS, 200)[:, None])
    assert (d < 0.0).all()


@settings(deadline=None, max_examples=300)
@given(x=st.tuples(coordinate, coordinate, coordinate))
def test_distance_is_finite_and_gradient_has_unit_length_at_any_point(sphere, x):
    d, g = sphere.sample([x])
    assert np.isfinite(d[0])
    assert np.linalg.norm(g[0]) == pytest.approx(1.0, abs=1e-5)
    # beyond a corner of the grid the surface point is only nearly the nearest one, as above
    assert d[0] == pytest.approx(np.linalg.norm(x) - RADIUS, rel=0.05, abs=0.003)


def test_sample_interpolates_the_predictions_of_the_surrounding_nodes(sphere):
    a = sphere.arrays
    cell = np.argwhere(a.block_of >= 0)[[0, 50, -1]]
    for i, j, k in cell:
        nodes = a.nodes[a.block_of[i, j, k] * 125:][:125].reshape(5, 5, 5, 4).astype(float)
        for at in np.random.default_rng(0).uniform(0.0, 4.0, (20, 3)):
            low = np.floor(at).astype(int)
            d, g = 0.0, np.zeros(3)
            for corner in np.ndindex(2, 2, 2):
                node = nodes[tuple(low + corner)]
                w = np.prod(1.0 - np.abs(at - low - corner))
                d += w * (node[0] + 0.5 * a.voxel * node[1:] @ (at - low - corner))
                g += w * node[1:]
            x = a.origin + (4 * np.array([i, j, k]) + at) * a.voxel
            distance, gradient = sphere.sample([x])
            assert distance[0] == pytest.approx(d, abs=1e-8)
            np.testing.assert_allclose(gradient[0], g / np.linalg.norm(g), atol=1e-6)


def test_batch_sampling_agrees_with_single_samples(sphere):
    rng = np.random.default_rng(3)
    x = np.concatenate([rng.uniform(-0.06, 0.06, (1000, 3)), np.zeros((1, 3)),
                        sphere.surface_points[:300] + rng.normal(0.0, 1e-3, (300, 3)),
                        rng.uniform(-1.0, 1.0, (30, 3))])
    alone = np.array([one(sphere.arrays, *row) for row in x])
    for order in (np.arange(len(x)), rng.permutation(len(x))):
        d, g = sphere.sample(x[order])
        np.testing.assert_allclose(d, alone[order, 0], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(g, alone[order, 1:], atol=1e-6)


@compiled
def one(field, x, y, z):
    return sample(field, x, y, z)


def test_samples_an_empty_array(sphere):
    d, g = sphere.sample(np.zeros((0, 3)))
    assert d.shape == (0,) and g.shape == (0, 3)


def test_distance_of_a_point_that_is_not_finite_is_nan(sphere):
    d, g = np.zeros(3), np.zeros((3, 3))
    x = np.array([[0.0, 0.0, 0.031], [np.nan, 0.0, 0.0], [0.0, -np.inf, 0.0]])
    sample_many(sphere.arrays, x, d, g)
    assert d[0] == pytest.approx(0.001, abs=1e-5) and np.isnan(d[1:]).all()


def test_samples_at_the_corners_of_the_grid(sphere):
    a = sphere.arrays
    high = a.origin + np.array(a.block_of.shape) * 4 * a.voxel
    corners = np.stack(np.meshgrid(*zip(a.origin, high), indexing='ij'), axis=-1).reshape(-1, 3)
    for x in (corners, np.nextafter(corners, np.inf), np.nextafter(corners, -np.inf)):
        d, g = sphere.sample(x)
        np.testing.assert_allclose(d, np.linalg.norm(x, axis=1) - RADIUS, rtol=0.01)


@pytest.mark.parametrize('points',
                         [[[np.nan, 0, 0]], [[np.inf, 0, 0]], [0.0, 0.0, 0.0], [[0.0, 0.0]]])
def test_rejects_invalid_points(sphere, points):
    with pytest.raises(InputError, match='three finite numbers'):
        sphere.sample(points)
