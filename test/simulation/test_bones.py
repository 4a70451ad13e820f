# SPDX-License-Identifier: Apache-2.0
"""Test the size, the topology and the anatomical features of the synthetic bones."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from gsdf_registration.common.rigid import fit_points, transform
from gsdf_registration.simulation import femur, hip
from gsdf_registration.simulation.implicit import carve, ellipsoid, join, polygon, tube


def load(path: Path) -> trimesh.Trimesh:
    return trimesh.load(path)


@pytest.mark.parametrize('name, extent, holes', [('hip', 220.0, 1), ('femur', 438.0, 0)])
def test_mesh_is_watertight_and_has_the_size_of_a_bone(bags: Path, name: str, extent: float,
                                                       holes: int) -> None:
    mesh = load(bags / f'{name}.ply')
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0
    assert mesh.body_count == 1
    assert mesh.euler_number == 2 - 2 * holes       # the obturator foramen
    assert abs(mesh.extents.max() - extent) < 5.0
    assert 20_000 < len(mesh.faces) < 40_000
    assert mesh.edges_unique_length.min() > 0.2     # no slivers
    assert (bags / f'{name}.ply').stat().st_size < 1_000_000


@pytest.mark.parametrize('name', ['hip', 'femur'])
def test_mesh_differs_from_its_mirror_image(bags: Path, name: str) -> None:
    points = trimesh.sample.sample_surface(load(bags / f'{name}.ply'), 1500, seed=0)[0]
    points -= points.mean(axis=0)
    points = points @ np.linalg.svd(points, full_matrices=False)[2].T
    tree = cKDTree(points)
    mirrors = [signs for signs in product([-1.0, 1.0], repeat=3) if np.prod(signs) < 0.0]
    assert min(fitted_rms(tree, points * signs) for signs in mirrors) > 2.0     # mm


def fitted_rms(tree: cKDTree, moving: np.ndarray) -> float:
    """Return the RMS distance after ICP from the initial alignment, mm."""
    for _ in range(40):
        moving = transform(fit_points(tree.data[tree.query(moving)[1]], moving), moving)
    return float(np.sqrt((tree.query(moving)[0] ** 2).mean()))


def test_acetabulum_is_a_hollow_sphere_with_a_fossa(hip_bone: Path) -> None:
    mesh = load(hip_bone)
    centres, normals = mesh.triangles_center, mesh.face_normals
    away = np.linalg.norm(centres, axis=1)
    inward = -centres / away[:, None]
    cup = (np.abs(away - hip.CUP_RADIUS) < 1.0) & ((normals * inward).sum(axis=1) > 0.97)
    area = mesh.area_faces[cup].sum()
    assert area > 0.5 * 2.0 * np.pi * hip.CUP_RADIUS**2     # more than half of a half sphere
    opens = (normals[cup] * mesh.area_faces[cup, None]).sum(axis=0)
    assert opens @ hip.CUP_AXIS > 0.85 * np.linalg.norm(opens)      # the notch interrupts the cup
    floor = ((normals * inward).sum(axis=1) > 0.9) & (centres @ hip.CUP_AXIS < 0.0)
    fossa = floor & (away > hip.CUP_RADIUS + 0.8) & (away < 32.0)
    assert mesh.area_faces[fossa].sum() > 200.0


def test_femoral_head_is_a_sphere_on_a_neck(femur_bone: Path) -> None:
    mesh = load(femur_bone)
    from_head = mesh.triangles_center - femur.HEAD
    away = np.linalg.norm(from_head, axis=1)
    head = (away < 1.05 * femur.HEAD_RADIUS) & (
        (mesh.face_normals * from_head).sum(axis=1) > 0.97 * away)
    assert mesh.area_faces[head].sum() > 0.6 * 4.0 * np.pi * femur.HEAD_RADIUS**2
    # except the bottom of the fovea
    assert (np.abs(away[head] - femur.HEAD_RADIUS) < 1.0).mean() > 0.99
    neck = mesh.section([1.0, 0.0, -1.0], np.array(femur.HEAD) + [25.0, -4.0, -22.0])
    assert neck is not None
    widths = [np.ptp(loop, axis=0).max() for loop in neck.discrete]
    assert 24.0 < min(widths) < 1.7 * femur.HEAD_RADIUS


def test_join_and_carve_equal_set_operations_away_from_the_blend() -> None:
    x = np.linspace(-30.0, 30.0, 61)
    p = (x, np.zeros(61), np.zeros(61))
    a = ellipsoid(p, (-5.0, 0.0, 0.0), (10.0, 10.0, 10.0))
    b = tube(p, [(5.0, 0.0, 0.0), (15.0, 0.0, 0.0)], [4.0, 4.0])
    np.testing.assert_allclose(a, np.abs(x + 5.0) - 10.0)
    np.testing.assert_allclose(b, np.maximum(1.0 - x, x - 19.0).clip(-4.0))
    union, difference = np.minimum(a, b), np.maximum(a, -b)
    assert (join(a, b, 2.0) <= union).all() and (join(a, b, 2.0) >= union - 0.5).all()
    assert (carve(a, b, 2.0) >= difference).all() and (carve(a, b, 2.0) <= difference + 0.5).all()


def test_polygon_returns_the_signed_distance() -> None:
    square = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
    x, y = np.array([1.0, 3.0, 5.0, 1.9]), np.array([1.0, 1.0, 6.0, 0.5])
    np.testing.assert_allclose(polygon(x, y, square), [-1.0, 1.0, 5.0, -0.1])
