# SPDX-License-Identifier: Apache-2.0
"""Test that the nodes of a field are exact, and do not depend on threads or units."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gsdf_registration.common.result import InputError
from gsdf_registration.field import build_field
from gsdf_registration.field.sample import CELLS, NODES
from gsdf_registration.field.surface import SPACING
from gsdf_registration.mesh.bone import make_bone

VOXEL = 0.001


def bone_of(mesh):
    return make_bone(mesh.vertices, mesh.faces)


def torus():
    return bone_of(trimesh.creation.torus(0.03, 0.01, major_sections=48, minor_sections=24))


def fine_nodes(field):
    """Return positions (n, 3) and samples (n, 4) of the fine nodes."""
    a = field.arrays
    corners = a.origin + np.argwhere(a.block_of >= 0) * CELLS * a.voxel
    steps = np.stack(np.indices((NODES,) * 3), axis=-1).reshape(-1, 3) * a.voxel
    return (corners[:, None] + steps).reshape(-1, 3), a.nodes[:a.first_coarse]


def coarse_nodes(field):
    a = field.arrays
    steps = np.stack(np.indices(np.array(a.block_of.shape) + 1), axis=-1).reshape(-1, 3)
    return a.origin + steps * CELLS * a.voxel, a.nodes[a.first_coarse:]


def box_distance(x, half):
    q = np.abs(x) - half
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def distance_to_mesh(x, vertices, faces):
    """Return unsigned distances (n,) by brute force over all faces, edges and corners."""
    a, b, c = (vertices[faces[:, i]][None] for i in range(3))
    p = x[:, None]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    inside = np.ones((len(x), len(faces)), dtype=bool)
    best = np.full((len(x), len(faces)), np.inf)
    for s, e in ((a, b), (b, c), (c, a)):
        t = np.clip(((p - s) * (e - s)).sum(2) / ((e - s) ** 2).sum(2), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(p - s - t[..., None] * (e - s), axis=2))
        inside &= (np.cross(e - s, p - s) * normal).sum(2) >= 0.0
    height = np.abs(((p - a) * normal).sum(2))
    return np.where(inside, np.minimum(best, height), best).min(axis=1)


def test_fine_nodes_of_a_box_are_exact():
    half = np.array([0.02, 0.015, 0.0105])
    field = build_field(bone_of(trimesh.creation.box(2 * half)), VOXEL)
    x, nodes = fine_nodes(field)
    np.testing.assert_allclose(nodes[:, 0], box_distance(x, half), atol=2e-9)
    step = 1e-5
    inner, outer = (box_distance(x + s * step * nodes[:, 1:], half) for s in (-1, 1))
    # along the gradient the distance has slope one, on the medial axis only in one direction
    np.testing.assert_allclose(np.maximum(outer - nodes[:, 0], nodes[:, 0] - inner),
                               step,
                               rtol=1e-3)


def test_coarse_nodes_of_a_box_are_accurate_to_a_voxel():
    half = np.array([0.02, 0.015, 0.0105])
    field = build_field(bone_of(trimesh.creation.box(2 * half)), VOXEL)
    x, nodes = coarse_nodes(field)
    np.testing.assert_allclose(nodes[:, 0], box_distance(x, half), atol=VOXEL)


@pytest.mark.parametrize('subdivisions', [0, 3])
def test_fine_nodes_are_exact_for_large_and_small_faces(subdivisions):
    bone = bone_of(trimesh.creation.icosphere(subdivisions, 0.02))
    x, nodes = fine_nodes(build_field(bone, VOXEL))
    some = np.arange(0, len(x), 97)
    exact = distance_to_mesh(x[some], bone.vertices, bone.faces)
    np.testing.assert_allclose(np.abs(nodes[some, 0]), exact, atol=2e-9)
    clear = np.abs(np.linalg.norm(x, axis=1) - 0.018) > 0.0025
    assert (np.sign(nodes[clear, 0]) == np.sign(np.linalg.norm(x[clear], axis=1) - 0.018)).all()


def test_fine_nodes_of_a_torus_are_exact():
    bone = torus()
    x, nodes = fine_nodes(build_field(bone, VOXEL))
    some = np.arange(0, len(x), 211)
    exact = distance_to_mesh(x[some], bone.vertices, bone.faces)
    np.testing.assert_allclose(np.abs(nodes[some, 0]), exact, atol=2e-9)


def test_all_gradients_have_unit_length():
    field = build_field(torus(), VOXEL)
    np.testing.assert_allclose(np.linalg.norm(field.arrays.nodes[:, 1:], axis=1), 1.0, atol=1e-6)


def test_band_of_three_voxels_has_fine_nodes():
    bone = torus()
    field = build_field(bone, VOXEL)
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0.0, 2.0 * np.pi, (2, 20000))
    r = 0.01 + rng.uniform(-3.0, 3.0, 20000) * VOXEL
    R = 0.03 + r * np.cos(v)
    x = np.stack([R * np.cos(u), R * np.sin(u), r * np.sin(v)], axis=1)
    cells = np.floor((x - field.arrays.origin) / (CELLS * VOXEL)).astype(int)
    assert (field.arrays.block_of[tuple(cells.T)] >= 0).all()


def test_thin_wall_has_two_sides():
    half = np.array([0.03, 0.03, 0.0008])
    field = build_field(bone_of(trimesh.creation.box(2 * half)), VOXEL)
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (5000, 3)) * (half + 0.003)
    d, _ = field.sample(x)
    assert np.sqrt(np.mean((d - box_distance(x, half)) ** 2)) < 0.15 * VOXEL
    x, nodes = fine_nodes(field)
    np.testing.assert_allclose(nodes[:, 0], box_distance(x, half), atol=2e-9)


def test_shared_nodes_of_adjacent_blocks_are_equal():
    field = build_field(torus(), VOXEL)
    a = field.arrays
    x, nodes = fine_nodes(field)
    key = np.round((x - a.origin) / a.voxel).astype(np.int64)
    _, first, same = np.unique(key, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_allclose(nodes[:, 0], nodes[first[same.ravel()], 0], atol=1e-12)


@pytest.mark.parametrize('threads', [2, 3, 0])
def test_field_is_bit_identical_for_any_number_of_threads(threads):
    one, other = (build_field(torus(), VOXEL, n) for n in (1, threads))
    assert one.arrays.nodes.tobytes() == other.arrays.nodes.tobytes()
    assert one.arrays.block_of.tobytes() == other.arrays.block_of.tobytes()
    assert one.surface_points.tobytes() == other.surface_points.tobytes()


@pytest.mark.parametrize('factor', [2.0, 16.0, 0.5])
def test_field_scales_with_the_unit(factor):
    mesh = trimesh.creation.torus(0.03, 0.01)
    one = build_field(make_bone(mesh.vertices, mesh.faces), 0.002)
    other = build_field(make_bone(mesh.vertices * factor, mesh.faces), 0.002 * factor)
    np.testing.assert_array_equal(one.arrays.block_of, other.arrays.block_of)
    np.testing.assert_array_equal(one.arrays.nodes * np.float32([factor, 1, 1, 1]),
                                  other.arrays.nodes)


def test_memory_grows_with_the_surface_and_not_with_the_volume():
    bone = bone_of(trimesh.creation.icosphere(4, 0.05))
    assert build_field(bone, 0.0005).nbytes < 5.0 * build_field(bone, 0.001).nbytes


def test_rejects_a_voxel_size_that_is_too_small_for_the_bone():
    with pytest.raises(InputError, match='larger voxel'):
        build_field(bone_of(trimesh.creation.icosphere(1, 1.0)), 0.0001)


def test_surface_sample_is_uniform_and_outward():
    bone = bone_of(trimesh.creation.icosphere(4, 0.05))
    field = build_field(bone, 0.002)
    area = 4.0 * np.pi * 0.05**2
    assert len(field.surface_points) == pytest.approx(area / SPACING**2, rel=0.02)
    radius = np.linalg.norm(field.surface_points, axis=1)
    np.testing.assert_allclose(radius, 0.05, atol=2e-4)
    assert ((field.surface_points * field.surface_normals).sum(axis=1) > 0.99 * radius).all()
    octants = (field.surface_points > 0.0) @ [1, 2, 4]
    assert np.ptp(np.bincount(octants)) < 0.05 * len(field.surface_points)


def test_field_of_a_point_cloud_matches_its_surface():
    n = 20000
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    normals = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    field = build_field(make_bone(0.03 * normals, None, normals), VOXEL)
    rng = np.random.default_rng(2)
    x = rng.normal(size=(5000, 3))
    x *= ((0.03 + rng.uniform(-0.003, 0.003, 5000)) / np.linalg.norm(x, axis=1))[:, None]
    d, g = field.sample(x)
    exact = np.linalg.norm(x, axis=1) - 0.03
    assert np.sqrt(np.mean((d - exact) ** 2)) < 2e-5
    assert ((g * x).sum(axis=1) / np.linalg.norm(x, axis=1)).min() > 0.99
    assert field.sample([[0.0, 0.0, 0.33]])[0][0] == pytest.approx(0.3, rel=1e-3)
    assert len(field.faces) == 0
