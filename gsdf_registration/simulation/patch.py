# SPDX-License-Identifier: Apache-2.0
"""The part of a bone that a wound exposes, and walks over it that never leave its triangles."""

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

FACING = -0.3       # the cosine to the approach direction beyond which the tip cannot reach round


@dataclass(frozen=True, eq=False)
class Patch:
    """
    A connected piece of a surface, made for walking; metres, bone frame.

    corners : (m, 3, 3) float64, the three corners of every triangle
    normals : (m, 3) float64, unit, outward
    neighbours : (m, 3) int32, the triangle across the edge from corner i to i + 1; -1 at the border
    areas : (m,) float64, m^2
    approach : (3,) float64, unit, from the bone toward the hand
    bounds : (2, 3) float64, box of the whole model
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
        """Return points (count, 3) uniform over the surface and their triangles (count,)."""
        rising = np.cumsum(self.areas)
        face = np.minimum(np.searchsorted(rising, rng.random(count) * rising[-1]), len(rising) - 1)
        u, v = rng.random((2, count, 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        a, b, c = np.moveaxis(self.corners[face], 1, 0)
        return a + u * (b - a) + v * (c - a), face


def exposed_patch(vertices: ArrayLike, faces: ArrayLike, centre: ArrayLike, radius: float,
                  approach: ArrayLike | None = None) -> Patch:
    """
    Return what a probe can reach.

    It is in a ball, faces the wound and is connected to what is nearest to ``centre``.

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
        If no surface lies in the ball.

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
            'there is hardly any bone in the region; give another centre or a larger radius')
    neighbours = _neighbours(faces[kept])
    one = _component(neighbours, int(np.argmin(away[kept])))
    # the last entry serves index -1
    renumbered = np.append(np.cumsum(one) - 1, -1).astype(np.int32)
    kept = kept[one]
    return Patch(corners[kept], normals[kept], renumbered[neighbours[one]], areas[kept], approach,
                 np.array([vertices.min(axis=0), vertices.max(axis=0)]))


def whole_surface(vertices: Array, faces: NDArray[np.int64]) -> Patch:
    """Return a whole closed surface (vertices m, outward faces) as a patch, seen from above."""
    corners = vertices[faces]
    normals, areas = _normals_and_areas(corners)
    return Patch(corners, normals, _neighbours(faces), areas, np.array([0.0, 0.0, 1.0]),
                 np.array([vertices.min(axis=0), vertices.max(axis=0)]))


def walk(patch: Patch, starts: Array, faces: NDArray[np.int64], headings: Array,
         strokes: NDArray[np.int64], steps: Array, turns: Array) -> tuple[Array, NDArray[np.int64]]:
    """
    Walk over a patch along steered geodesics: straight across every edge, bouncing off the border.

    Parameters
    ----------
    patch : Patch
    starts : (k, 3) float, m, on the triangles ``faces`` (k,)
    headings : (k,) float, rad, in the plane of the first triangle
    strokes : (n,) int, rising, which start the sample belongs to
    steps : (n,) float, m, from the sample before
    turns : (n,) float, rad, taken before the step

    Returns
    -------
    points : (n, 3) float, m, on the surface to rounding
    triangles : (n,) int

    """
    points = np.zeros((len(steps), 3))
    triangles = np.zeros(len(steps), dtype=np.int64)
    _walk(patch.corners, patch.normals, patch.neighbours, starts, faces, headings, strokes, steps,
          turns, points, triangles)
    return points, triangles


def _normals_and_areas(corners: Array) -> tuple[Array, Array]:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normals, axis=1)
    return normals / np.maximum(twice, 1e-300)[:, None], twice / 2.0


def _neighbours(faces: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the triangle across each edge (m, 3); -1 where there is none, or more than one."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, name, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(name.ravel(), kind='stable')
    twice = order[np.repeat(count == 2, count)].reshape(-1, 2)
    across = np.full(len(edges), -1, dtype=np.int32)
    across[twice[:, 0]], across[twice[:, 1]] = twice[:, 1] // 3, twice[:, 0] // 3
    return across.reshape(-1, 3)


def _component(neighbours: NDArray[np.int32], seed: int) -> NDArray[np.bool_]:
    """Return which triangles hang together with triangle ``seed``."""
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
def _turned(d: Array, n: Array, angle: float) -> Array:
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
            d = _turned(_unit(corners[f, 1] - corners[f, 0]), normals[f], headings[strokes[i]])
        else:
            d = _turned(d, normals[f], turns[i])
            p, d, f = _step(corners, normals, neighbours, p, d, f, steps[i])
        points[i] = p
        triangles[i] = f


@compiled
def _step(corners: Array, normals: Array, neighbours: NDArray[np.int32], p: Array, d: Array, f: int,
          length: float) -> tuple[Array, Array, int]:
    """Go ``length`` from ``p`` along ``d`` on triangle ``f``, over as many edges as it takes."""
    for _ in range(1000):
        # the edge through which the line leaves: its outward normals in the plane are edge x normal
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
            # unfold the next triangle about the edge: the part along stays, that across goes inward
            d = _unit(np.dot(d, along) * along + np.dot(d, out) * _cross(along, normals[to]))
            f = to
    return p, d, f
