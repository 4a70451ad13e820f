# SPDX-License-Identifier: Apache-2.0
"""The part of a bone that an incision exposes, and paths over its triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array

FACING = -0.3       # smallest cosine between normal and approach at which the tip can touch


@dataclass(frozen=True, eq=False)
class Patch:
    """
    A connected part of a surface, bone frame.

    corners : (m, 3, 3) float64, m, the three corners of each triangle
    normals : (m, 3) float64, unit length, outward
    neighbours : (m, 3) int32, the triangle across the edge from corner i to i + 1; -1 at the border
    areas : (m,) float64, m^2
    approach : (3,) float64, unit length, from the bone toward the hand
    bounds : (2, 3) float64, m, bounding box of the whole model
    """

    corners: Array
    normals: Array
    neighbours: NDArray[np.int32]
    areas: Array
    approach: Array
    bounds: Array

    @property
    def centre(self) -> Array:
        """Return the centroid (3,) of the surface."""
        return np.average(self.corners.mean(axis=1), axis=0, weights=self.areas)

    def random_points(self, count: int,
                      rng: np.random.Generator) -> tuple[Array, NDArray[np.int64]]:
        """Return points (count, 3), uniformly distributed, and their triangles (count,)."""
        rising = np.cumsum(self.areas)
        face = np.minimum(np.searchsorted(rising, rng.random(count) * rising[-1]), len(rising) - 1)
        u, v = rng.random((2, count, 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        a, b, c = np.moveaxis(self.corners[face], 1, 0)
        return a + u * (b - a) + v * (c - a), face


def exposed_patch(vertices: ArrayLike, faces: ArrayLike, centre: ArrayLike, radius: float,
                  approach: ArrayLike | None = None) -> Patch:
    """
    Return the part of a surface that a probe can touch.

    It is inside a sphere, faces the approach and is connected to the triangle nearest to
    ``centre``.

    Parameters
    ----------
    vertices : (n, 3) float, m, bone frame; shared by neighbouring triangles
    faces : (m, 3) int, counter-clockwise seen from outside
    centre : (3,) float, m
    radius : float, m
    approach : (3,) float, from the bone toward the hand; None: the normal nearest to ``centre``

    Raises
    ------
    InputError
        If fewer than ten triangles are in the sphere.

    """
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    corners = vertices[faces]
    normals, areas = _normals_and_areas(corners)
    away = np.linalg.norm(corners.mean(axis=1) - np.asarray(centre, dtype=np.float64), axis=1)
    if approach is None:
        approach = normals[np.argmin(np.where(areas > 0.0, away, np.inf))]
    approach = np.asarray(approach, dtype=np.float64) / np.linalg.norm(approach)
    kept = np.flatnonzero((away < radius) & (areas > 0.0) & (normals @ approach > FACING))
    if len(kept) < 10:
        raise InputError(
            'the region has too little bone; choose another centre or a larger radius')
    neighbours = _neighbours(faces[kept])
    one = _component(neighbours, int(np.argmin(away[kept])))
    # the last entry is for index -1
    renumbered = np.append(np.cumsum(one) - 1, -1).astype(np.int32)
    kept = kept[one]
    return Patch(corners[kept], normals[kept], renumbered[neighbours[one]], areas[kept], approach,
                 np.array([vertices.min(axis=0), vertices.max(axis=0)]))


def whole_surface(vertices: Array, faces: NDArray[np.int64]) -> Patch:
    """Return a closed surface, m, with outward faces as a patch; the approach is along z."""
    corners = vertices[faces]
    normals, areas = _normals_and_areas(corners)
    return Patch(corners, normals, _neighbours(faces), areas, np.array([0.0, 0.0, 1.0]),
                 np.array([vertices.min(axis=0), vertices.max(axis=0)]))


def walk(patch: Patch, starts: Array, faces: NDArray[np.int64], headings: Array,
         strokes: NDArray[np.int64], steps: Array, turns: Array) -> tuple[Array, NDArray[np.int64]]:
    """
    Follow steered geodesics over a patch: straight across edges, reflected at the border.

    Parameters
    ----------
    patch : Patch
    starts : (k, 3) float, m, on the triangles ``faces`` (k,)
    headings : (k,) float, rad, initial directions in the plane of these triangles
    strokes : (n,) int, rising, index of the start of each sample
    steps : (n,) float, m, distance from the previous sample
    turns : (n,) float, rad, change of direction before the step

    Returns
    -------
    points : (n, 3) float, m, on the surface up to rounding
    triangles : (n,) int

    """
    points = np.zeros((len(steps), 3))
    triangles = np.zeros(len(steps), dtype=np.int64)
    _walk(patch.corners, patch.normals, patch.neighbours, starts, faces, headings, strokes, steps,
          turns, points, triangles)
    return points, triangles


def stroke_over(patch: Patch, place: Array, points: int, step: float, bend: float,
                rng: np.random.Generator) -> Array:
    """
    Return the tips (n, 3), m, of a stroke along an arc over a place.

    Parameters
    ----------
    patch : Patch
    place : (3,) float, m, bone frame
        The middle of the stroke is on the triangle nearest to it.
    points : int
    step : float
        Distance of the tips, m.
    bend : float
        Standard deviation of the curvature, 1/m.
    rng : numpy Generator

    """
    face = int(np.argmin(np.linalg.norm(patch.corners.mean(axis=1) - place, axis=1)))
    # from the place outward for half the stroke, then back over the whole stroke
    turns = np.full(points // 2 + points, rng.normal(0.0, bend) * step)
    turns[points // 2], turns[points // 2 + 1:] = np.pi, -turns[points // 2 + 1:]
    tips, _ = walk(patch, patch.corners[face].mean(axis=0)[None], np.array([face]),
                   rng.uniform(0.0, 2.0 * np.pi, 1), np.zeros(len(turns), dtype=np.int64),
                   np.full(len(turns), step), turns)
    return tips[points // 2:]


def _normals_and_areas(corners: Array) -> tuple[Array, Array]:
    """Return unit normals (m, 3) and areas (m,) of triangles (m, 3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normals, axis=1)
    return normals / np.maximum(twice, 1e-300)[:, None], twice / 2.0


def _neighbours(faces: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the triangle across each edge (m, 3); -1 if there is none or more than one."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, name, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(name.ravel(), kind='stable')
    twice = order[np.repeat(count == 2, count)].reshape(-1, 2)
    across = np.full(len(edges), -1, dtype=np.int32)
    across[twice[:, 0]], across[twice[:, 1]] = twice[:, 1] // 3, twice[:, 0] // 3
    return across.reshape(-1, 3)


def _component(neighbours: NDArray[np.int32], seed: int) -> NDArray[np.bool_]:
    """Return a mask of the triangles that are connected to triangle ``seed``."""
    n = len(neighbours)
    rows, columns = np.repeat(np.arange(n), 3), neighbours.ravel()
    real = columns >= 0
    graph = sparse.coo_matrix((np.ones(real.sum()), (rows[real], columns[real])), (n, n))
    label = connected_components(graph, directed=False)[1]
    return np.asarray(label == label[seed])


@compiled
def _cross(a: Array, b: Array) -> Array:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@compiled
def _unit(a: Array) -> Array:
    return a / math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@compiled
def _rotate(d: Array, n: Array, angle: float) -> Array:
    return _unit(math.cos(angle) * d + math.sin(angle) * _cross(n, d))


@compiled
def _walk(corners: Array, normals: Array, neighbours: NDArray[np.int32], starts: Array,
          faces: NDArray[np.int64], headings: Array, strokes: NDArray[np.int64], steps: Array,
          turns: Array, points: Array, triangles: NDArray[np.int64]) -> None:
    """Fill ``points`` and ``triangles``, see `walk`."""
    f = 0
    p = starts[0].copy()
    d = p.copy()
    for i in range(len(steps)):
        if i == 0 or strokes[i] != strokes[i - 1]:
            f = faces[strokes[i]]
            p = starts[strokes[i]].copy()
            d = _rotate(_unit(corners[f, 1] - corners[f, 0]), normals[f], headings[strokes[i]])
        else:
            d = _rotate(d, normals[f], turns[i])
            p, d, f = _step(corners, normals, neighbours, p, d, f, steps[i])
        points[i] = p
        triangles[i] = f


@compiled
def _step(corners: Array, normals: Array, neighbours: NDArray[np.int32], p: Array, d: Array, f: int,
          length: float) -> tuple[Array, Array, int]:
    """Move ``length`` from ``p`` along ``d`` on triangle ``f``, across any number of edges."""
    for _ in range(1000):
        # find the edge that the line crosses; outward normals in the plane are edge x normal
        nearest = length
        leaving = -1
        out = d
        along = d
        for k in range(3):
            a = corners[f, k]
            edge = _unit(corners[f, (k + 1) % 3] - a)
            outward = _cross(edge, normals[f])
            rate = np.dot(d, outward)
            if rate > 1e-12:
                t = max(np.dot(a - p, outward) / rate, 0.0)
                if t < nearest:
                    nearest, leaving, out, along = t, k, outward, edge
        p = p + nearest * d
        if leaving < 0:
            break
        length -= nearest
        to = neighbours[f, leaving]
        if to < 0:
            d = _unit(d - 2.0 * np.dot(d, out) * out)
        else:
            # unfold the next triangle: the component along the edge is kept
            d = _unit(np.dot(d, along) * along + np.dot(d, out) * _cross(along, normals[to]))
            f = to
    return p, d, f
