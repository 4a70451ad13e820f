# SPDX-License-Identifier: Apache-2.0
"""Test the field for the centre of a ball tip: on smooth bones, on edges and above grooves."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, displacement, rotation_exp
from gsdf_registration.field import Field, build_field, save_field
from gsdf_registration.field.sample import UNCERTAIN
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.search.descent import gauss_newton_steps
from gsdf_registration.solver import solve

SPHERE, HALF = 0.03, np.array([0.02, 0.03, 0.04])      # m, radius, and half the sides of the box
R = rotation_exp([0.4, -0.3, 0.8])      # of boxes, so that no edge is along the grid
DEPTH = 0.004       # m, of the groove


@pytest.fixture(scope='module')
def sphere() -> Field:
    mesh = trimesh.creation.icosphere(5, SPHERE)
    return build_field(make_bone(mesh.vertices, mesh.faces), 0.001)


@pytest.fixture(scope='module')
def box() -> Field:
    mesh = trimesh.creation.box(2.0 * HALF)
    return build_field(make_bone(np.asarray(mesh.vertices) @ R.T, mesh.faces), 0.001)


@pytest.fixture(scope='module')
def grooved() -> Field:
    return build_field(make_bone(*groove()), 0.001)


def groove() -> tuple[Array, np.ndarray]:
    """Return a block with a groove of 90 degrees along y in its top, z = 15 mm."""
    outline = np.array([(-30, -15), (30, -15), (30, 15), (4, 15), (0, 11), (-4, 15), (-30, 15)])
    caps = np.array([(0, 1, 4), (1, 2, 3), (1, 3, 4), (0, 4, 5), (0, 5, 6)])
    n = len(outline)
    x, z = np.tile(1e-3 * outline, (2, 1)).T
    vertices = np.stack([x, np.repeat([-0.02, 0.02], n), z], axis=1)
    first, second = np.arange(n), np.roll(np.arange(n), -1)
    faces = np.concatenate([np.stack([first, second, second + n], axis=1),
                            np.stack([first, second + n, first + n], axis=1),
                            caps[:, ::-1], caps + n])
    return vertices @ R.T, faces[:, ::-1]


def directions(n: int) -> Array:
    x = np.random.default_rng(0).normal(size=(n, 3))
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


@pytest.mark.parametrize('radius', [0.0005, 0.0015, 0.003])
def test_the_centre_of_a_ball_on_a_sphere_has_no_residual(sphere: Field, radius: float) -> None:
    u = directions(3000)
    d, g = sphere.for_tip(radius).sample(u * (SPHERE + radius))
    assert np.sqrt(np.mean(d**2)) < 1.5e-5
    assert (g * u).sum(axis=1).min() > 0.999


@pytest.mark.parametrize('radius', [0.0005, 0.0015])
def test_the_offset_of_a_box_has_round_edges(box: Field, radius: float) -> None:
    p = np.random.default_rng(1).uniform(-1.0, 1.0, (20_000, 3)) * (HALF + 0.004)
    beyond = np.abs(p) - HALF
    exact = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
    near = np.abs(exact - radius) < 2e-4
    d, _ = box.for_tip(radius).sample(p[near] @ R.T)
    assert np.sqrt(np.mean((d - exact[near] + radius)**2)) < 3e-5


def test_all_radii_share_the_arrays_and_no_radius_has_the_same_bits(sphere: Field) -> None:
    ball = sphere.for_tip(0.001)
    assert ball.arrays.nodes is sphere.arrays.nodes and ball.tip_radius == 0.001
    assert ball.for_tip(0.001) is ball and sphere.for_tip(0.0) is sphere
    points = directions(500) * SPHERE * np.linspace(0.2, 3.0, 500)[:, None]
    for mine, theirs in zip(ball.for_tip(0.0).sample(points), sphere.sample(points)):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_allclose(ball.sample(points)[0], sphere.sample(points)[0] - 0.001, atol=1e-8)


def test_a_saved_field_does_not_depend_on_the_radius(sphere: Field, tmp_path: Path) -> None:
    save_field(sphere, tmp_path / 'sharp.gsdf')
    save_field(sphere.for_tip(0.002), tmp_path / 'ball.gsdf')
    assert (tmp_path / 'sharp.gsdf').read_bytes() == (tmp_path / 'ball.gsdf').read_bytes()


@pytest.mark.parametrize('radius', [-0.001, math.nan, math.inf])
def test_a_radius_that_is_none_is_refused_in_one_sentence(sphere: Field, radius: float) -> None:
    with pytest.raises(InputError, match='^the radius of the probe tip must be 0 or a positive'):
        sphere.for_tip(radius)


def test_contacts_lie_on_the_bone_and_unknown_points_are_kept(box: Field) -> None:
    centres = np.vstack([HALF * [0.5, 0.5, 1.0] + [0.0, 0.0, 0.0015], np.full(3, np.nan)]) @ R.T
    contacts = box.for_tip(0.0015).contacts(centres)
    np.testing.assert_allclose(contacts[0], HALF * [0.5, 0.5, 1.0] @ R.T, atol=1e-6)
    assert np.isnan(contacts[1]).all()
    np.testing.assert_array_equal(box.contacts(centres), centres)


def test_the_search_uses_the_offset_surface(sphere: Field) -> None:
    centres = np.ascontiguousarray((directions(400) * (SPHERE + 0.002)).T, dtype=np.float32)
    costs = []
    for field in (sphere, sphere.for_tip(0.002)):
        cost = np.zeros(1)
        gauss_newton_steps(field.arrays, True, centres, np.eye(3)[None].copy(), np.zeros((1, 3)),
                           np.array([0.001]), cost)
        costs.append(cost[0])
    assert costs[0] > 0.7 and costs[1] < 0.01


def on_both_walls(radius: float, y: Array) -> Array:
    """Return centres (n, 3) of a ball in the groove."""
    height = 0.015 - DEPTH + radius * math.sqrt(2.0)
    return np.column_stack([np.zeros_like(y), y, np.full_like(y, height)]) @ R.T


@pytest.mark.parametrize('radius', [0.0005, 0.0015])
def test_a_ball_on_both_walls_of_a_groove_does_not_pull(grooved: Field, radius: float) -> None:
    d, g = grooved.for_tip(radius).sample(on_both_walls(radius, np.linspace(-0.015, 0.015, 300)))
    assert np.abs(d).max() < 2e-4      # a fifth of a voxel
    np.testing.assert_allclose(np.linalg.norm(g, axis=1), UNCERTAIN, atol=1e-6)
    # away from the groove, and without a ball, every gradient has unit length
    walls = np.array([[0.02, 0.0, 0.0155], [-0.03, 0.0, 0.0]]) @ R.T
    for field, places in ((grooved.for_tip(radius), walls),
                          (grooved, on_both_walls(radius, np.linspace(-0.015, 0.015, 300)))):
        np.testing.assert_allclose(np.linalg.norm(field.sample(places)[1], axis=1), 1.0, atol=1e-6)


def test_a_registration_over_a_groove_is_not_biased(grooved: Field) -> None:
    radius, sigma, errors = 0.001, 1e-4, []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        x, y, z = rng.uniform(-1.0, 1.0, (3, 200)) * [[0.028], [0.018], [0.01]]
        aside = np.abs(x) > 0.006
        flat = [np.column_stack(sides) for sides in (
            (x[aside], y[aside], np.full(aside.sum(), 0.015 + radius)),
            (np.full_like(y, 0.03 + radius), y, z), (x, np.full_like(x, 0.02 + radius), z))]
        centres = np.vstack([np.concatenate(flat) @ R.T,
                             on_both_walls(radius, rng.uniform(-0.017, 0.017, 400))])
        points = centres + sigma * rng.normal(size=centres.shape)
        T = solve(points, grooved.for_tip(radius), np.eye(4), Config().solver).T_bone_tracker
        errors.append(displacement(T, np.eye(4), centres[-400:]).mean())
    # 0.13 mm if the gradient had unit length
    assert np.mean(errors) < 2.5e-5
