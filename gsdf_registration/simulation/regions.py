# SPDX-License-Identifier: Apache-2.0
"""Find the area that an incision exposes from the shape of the bone."""

from __future__ import annotations

import numpy as np
import trimesh

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.patch import Patch, exposed_patch

# m, of the sphere that contains the exposed area
RADIUS = {'acetabulum': 0.040, 'proximal_femur': 0.042, 'condyles': 0.042, 'proximal_tibia': 0.042}

CUP_OR_HEAD = (0.017, 0.030)    # m, radii
# m^2, smallest areas; other round parts of 40 bones have at most 0.0008 and 0.0020
CUP_AREA, HEAD_AREA = 0.0011, 0.0028


def named_patch(region: str,
                vertices: Array,
                faces: np.ndarray,
                radius: float | None = None) -> Patch:
    """
    Return the exposed patch of a region.

    Parameters
    ----------
    region : 'acetabulum', 'proximal_femur', 'condyles' or 'proximal_tibia'
    vertices : (n, 3) float, m
    faces : (m, 3) int, outward
    radius : float, m, of the sphere that contains the exposed area; None: 40 or 42 mm

    Raises
    ------
    InputError
        If the region is unknown or the bone does not have it.

    """
    if region not in RADIUS:
        raise InputError(f'region "{region}" is unknown; choose one of {", ".join(RADIUS)}')
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    centre, approach = {
        'acetabulum': _acetabulum, 'proximal_femur': _proximal_femur, 'condyles': _condyles,
        'proximal_tibia': _proximal_tibia
    }[region](mesh)
    return exposed_patch(vertices, faces, centre, radius or RADIUS[region], approach)


def femoral_head(vertices: Array, faces: np.ndarray) -> Array:
    """Return the centre (3,), m, of the head of a femur; raise `InputError` if it has none."""
    return _sphere(trimesh.Trimesh(vertices, faces, process=False), hollow=False)[0]


def _acetabulum(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Return the centre of the cup and the direction in which it opens."""
    centre, radius, normals = _sphere(mesh, hollow=True)
    return centre, _unit(normals.mean(axis=0))


def _proximal_femur(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Return a point on the neck, and the normal of the plane through neck and shaft."""
    head, radius, _ = _sphere(mesh, hollow=False)
    points = _samples(mesh)[0]
    away = np.linalg.norm(points - head, axis=1)
    toward = _unit(points[(away > 1.2 * radius) & (away < 0.07)].mean(axis=0) - head)
    return head + 0.022 * toward, _unit(np.cross(toward, mesh.bounds.mean(axis=0) - head))


def _condyles(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Return the distal end of the femur and the axis outward."""
    head, _, _ = _sphere(mesh, hollow=False)
    return max(_ends(mesh), key=lambda end: float(np.linalg.norm(end[0] - head)))


def _proximal_tibia(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Return the wider end of the bone and the axis outward."""
    points = _samples(mesh)[0]

    def width(end: tuple[Array, Array]) -> float:
        near = points[np.linalg.norm(points - end[0], axis=1) < 0.05]
        return float(np.trace(np.cov(near.T)))
    return max(_ends(mesh), key=width)


def _ends(mesh: trimesh.Trimesh) -> list[tuple[Array, Array]]:
    """Return both ends of a long bone: the centroid of the last 40 mm and the axis outward."""
    points = _samples(mesh)[0]
    axis = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    ends = []
    for direction in (axis, -axis):
        height = points @ direction
        ends.append((points[height > height.max() - 0.04].mean(axis=0), direction))
    return ends


def _samples(mesh: trimesh.Trimesh, count: int = 3000) -> tuple[Array, Array]:
    """Return points (count, 3) on the surface and their outward normals; deterministic."""
    points, face = trimesh.sample.sample_surface(mesh, count, seed=0)
    return np.asarray(points), np.asarray(mesh.face_normals[face])


def _sphere(mesh: trimesh.Trimesh, hollow: bool, tries: int = 3000) -> tuple[Array, float, Array]:
    """
    Return centre, radius (m) and normals of the largest spherical part of the surface.

    RANSAC: the normals of two points on a sphere intersect at its centre.
    """
    points, normals = _samples(mesh)
    if not hollow:
        normals = -normals      # toward the centre, as the outward normals of a hollow are
    i, j = np.random.default_rng(0).integers(0, len(points), (2, 40 * tries))
    near = ((np.linalg.norm(points[i] - points[j], axis=1) < 0.05)
            & (np.abs((normals[i] * normals[j]).sum(axis=1)) < 0.9))
    i, j = i[near][:tries], j[near][:tries]
    cosine = (normals[i] * normals[j]).sum(axis=1)
    gap = points[j] - points[i]
    along_i, along_j = (gap * normals[i]).sum(axis=1), (gap * normals[j]).sum(axis=1)
    r_i = (along_i - cosine * along_j) / (1.0 - cosine**2)
    r_j = (cosine * along_i - along_j) / (1.0 - cosine**2)
    centres = 0.5 * (points[i] + r_i[:, None] * normals[i] + points[j] + r_j[:, None] * normals[j])
    radii = 0.5 * (r_i + r_j)
    valid = (np.abs(r_i - r_j) < 0.003) & (radii > CUP_OR_HEAD[0]) & (radii < CUP_OR_HEAD[1])
    best, members = 0, np.zeros(len(points), dtype=bool)
    for centre, radius in zip(centres[valid], radii[valid]):
        ray = centre - points
        away = np.linalg.norm(ray, axis=1)
        on = (np.abs(away - radius) < 0.0015) & ((ray * normals).sum(axis=1) > 0.95 * away)
        if on.sum() > best:
            best, members = int(on.sum()), on
    if mesh.area * best / len(points) < (CUP_AREA if hollow else HEAD_AREA):
        raise InputError(
            f'the bone has no {"cup" if hollow else "head"} with a radius of 17 to 30 mm; '
            'check the model, or set the region as x,y,z,radius')
    # least squares through its members: |x|^2 = 2 c.x + (r^2 - |c|^2)
    on_it = points[members]
    rows = np.column_stack([2.0 * on_it, np.ones(best)])
    solution = np.linalg.lstsq(rows, (on_it**2).sum(axis=1), rcond=None)[0]
    return solution[:3], float(np.sqrt(solution[3] + solution[:3] @ solution[:3])), normals[members]


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)
