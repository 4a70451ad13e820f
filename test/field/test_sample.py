# SPDX-License-Identifier: Apache-2.0
"""A field answers anywhere: near, far and out of its box."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.bone import make_bone
from gsdf_registration.field import build_field
from gsdf_registration.result import InputError

RADIUS = 0.03
coordinate = st.one_of(st.floats(-0.06, 0.06), st.floats(-1e6, 1e6))


@pytest.fixture(scope='module')
def sphere():
    mesh = trimesh.creation.icosphere(5, RADIUS)
    return build_field(make_bone(mesh.vertices, mesh.faces), 0.001)


def directions(n):
    x = np.random.default_rng(0).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def test_distances_in_the_band_are_third_order(sphere):
    u = directions(5000)
    r = RADIUS + np.random.default_rng(1).uniform(-0.003, 0.003, 5000)
    d, g = sphere.sample(u * r[:, None])
    assert np.sqrt(np.mean((d - (r - RADIUS)) ** 2)) < 1.5e-5      # the facets alone: 1e-5
    assert (g * u).sum(axis=1).min() > 0.999


@pytest.mark.parametrize('far', [0.05, 0.3, 3.0, 1000.0])
def test_far_points_are_pulled_back(sphere, far):
    u = directions(500)
    d, g = sphere.sample(u * (RADIUS + far))
    # to a point of the surface, nearly the nearest
    assert (d > far - 1e-4).all() and (d < 1.05 * far + 1e-4).all()
    back = u * (RADIUS + far) - d[:, None] * g
    assert np.abs(np.linalg.norm(back, axis=1) - RADIUS).max() < 0.002 + 1e-4 * far


def test_the_inside_is_negative_to_the_centre(sphere):
    d, _ = sphere.sample(directions(200) * np.linspace(0.0, 0.9 * RADIUS, 200)[:, None])
    assert (d < 0.0).all()


@settings(deadline=None, max_examples=300)
@given(x=st.tuples(coordinate, coordinate, coordinate))
def test_any_point_has_a_finite_distance_and_a_unit_gradient(sphere, x):
    d, g = sphere.sample([x])
    assert np.isfinite(d[0])
    assert np.linalg.norm(g[0]) == pytest.approx(1.0, abs=1e-5)
    assert d[0] == pytest.approx(np.linalg.norm(x) - RADIUS, rel=0.02, abs=0.003)


def test_the_corners_and_faces_of_the_box_are_in_range(sphere):
    a = sphere.arrays
    high = a.origin + np.array(a.block_of.shape) * 4 * a.voxel
    corners = np.stack(np.meshgrid(*zip(a.origin, high), indexing='ij'), axis=-1).reshape(-1, 3)
    for x in (corners, np.nextafter(corners, np.inf), np.nextafter(corners, -np.inf)):
        d, g = sphere.sample(x)
        np.testing.assert_allclose(d, np.linalg.norm(x, axis=1) - RADIUS, rtol=0.01)


@pytest.mark.parametrize('points',
                         [[[np.nan, 0, 0]], [[np.inf, 0, 0]], [0.0, 0.0, 0.0], [[0.0, 0.0]]])
def test_what_is_no_point_is_refused(sphere, points):
    with pytest.raises(InputError, match='three finite numbers'):
        sphere.sample(points)
