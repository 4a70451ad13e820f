# SPDX-License-Identifier: Apache-2.0
"""
Repair the defects that segmentation and export leave in a mesh.

Every step takes ``vertices`` (n, 3) float64 and ``faces`` (m, 3) int64, and appends a sentence to
``notes`` if it changes the mesh. A body is a set of faces connected by shared edges; ``bodies``
(m,) is the number of the body of each face.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration.common.components import components
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.rigid import Array
from gsdf_registration.mesh.winding import winding_numbers

MERGE_TOLERANCE = 1e-6  # share of the extent; vertices closer than this are duplicates
MIN_BODY_AREA = 0.01    # share of the area of the largest body; smaller bodies are noise
SAMPLES = 24            # places on a body where its orientation is tested


def merge_vertices(vertices: Array, faces: np.ndarray,
                   notes: list[str]) -> tuple[Array, np.ndarray]:
    """Merge duplicate vertices and keep the coordinates of the first of them."""
    low = vertices.min(axis=0)
    close = MERGE_TOLERANCE * float(np.ptp(vertices, axis=0).max())
    # merge within cells of this size first, which bounds the number of neighbours of a vertex
    cell = ((vertices - low) / close).astype(np.int64)
    _, first, label = np.unique((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2],
                                return_index=True,
                                return_inverse=True)
    representative = first[label.ravel()]
    pairs = cKDTree(vertices[first]).query_pairs(close, output_type='ndarray')
    if len(pairs):
        _, group = components(pairs, len(first))
        lowest = np.full(len(first), len(vertices))
        np.minimum.at(lowest, group, first)
        representative = lowest[group][label.ravel()]
    merged = int((representative != np.arange(len(vertices))).sum())
    if merged:
        notes.append(f'Merged {format_count(merged, "duplicate vertex", "duplicate vertices")}.')
    return drop_unused_vertices(vertices, representative[faces])


def drop_unused_vertices(vertices: Array, faces: np.ndarray) -> tuple[Array, np.ndarray]:
    """Drop the vertices that no face uses; the order of the others is kept."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def drop_invalid_faces(vertices: Array, faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """Drop faces with zero area, and duplicate faces regardless of their winding."""
    extent = float(np.ptp(vertices, axis=0).max())
    flat = face_areas(vertices, faces) <= 1e-12 * extent**2
    if flat.any():
        notes.append(f'Dropped {format_count(int(flat.sum()), "face")} with zero area.')
        faces = faces[~flat]
    low, middle, high = np.sort(faces, axis=1).T
    order = np.lexsort((high, middle, low))
    repeated = np.zeros(len(faces), dtype=bool)
    same = (np.diff(low[order]) == 0) & (np.diff(middle[order]) == 0) & (np.diff(high[order]) == 0)
    repeated[order[1:][same]] = True
    if repeated.any():
        notes.append(f'Dropped {format_count(int(repeated.sum()), "duplicate face")}.')
    return faces[~repeated]


def wind_consistently(faces: np.ndarray, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """
    Give the faces of each body a consistent winding and return them with their ``bodies``.

    The nodes of a graph are the faces as they are and the faces flipped. Across every edge with
    exactly two faces, the windings that agree are connected. The component of the first face of a
    body is a consistent winding.
    """
    pairs, agree = _adjacent_faces(faces)
    m = len(faces)
    count, bodies = components(pairs, m)
    if agree.all():
        return faces, bodies
    left, right = pairs.T
    other = np.where(agree, right, right + m)
    _, winding = components(
        np.concatenate(
            [np.stack([left, other], axis=1),
             np.stack([left + m, (other + m) % (2 * m)], axis=1)]), 2 * m)
    first = np.full(count, m)
    np.minimum.at(first, bodies, np.arange(m))
    flipped = winding[:m] != winding[first[bodies]]
    # keep the winding of the majority of the faces of a body
    minority = np.bincount(bodies, flipped) * 2 > np.bincount(bodies)
    flipped ^= minority[bodies]
    notes.append(f'Flipped {format_count(int(flipped.sum()), "face")} to match the neighbours.')
    return np.where(flipped[:, None], faces[:, ::-1], faces), bodies


def large_bodies(vertices: Array, faces: np.ndarray, bodies: np.ndarray,
                 notes: list[str]) -> np.ndarray:
    """Return a mask (m,) of the faces of all bodies but the small ones."""
    area = np.bincount(bodies, face_areas(vertices, faces))
    small = area < MIN_BODY_AREA * area.max()
    if small.any():
        notes.append(f'Dropped {format_count(int(small.sum()), "small body", "small bodies")}.')
    return ~small[bodies]


def orient_outward(vertices: Array, faces: np.ndarray, bodies: np.ndarray,
                   notes: list[str]) -> np.ndarray:
    """
    Flip the bodies that are inside out.

    On a face the winding number of a body is the mean of its values on both sides: +1/2 if the face
    is oriented outward, -1/2 if inward, and about that if the body has holes (Jacobson et al.,
    SIGGRAPH 2013).
    """
    flipped = 0
    faces = faces.copy()
    for body in np.unique(bodies):
        mine = np.flatnonzero(bodies == body)
        area = np.cumsum(face_areas(vertices, faces[mine]))
        sampled = np.searchsorted(area, (np.arange(SAMPLES) + 0.5) / SAMPLES * area[-1])
        centroids = vertices[faces[mine[sampled]]].mean(axis=1)
        if winding_numbers(vertices, faces[mine], centroids).sum() < 0.0:
            faces[mine] = faces[mine, ::-1]
            flipped += 1
    if flipped:
        count = format_count(len(np.unique(bodies)), 'body', 'bodies')
        notes.append(f'Flipped {flipped} of {count} that were inside out.')
    return faces


def outer_bodies(vertices: Array, faces: np.ndarray, bodies: np.ndarray,
                 notes: list[str]) -> np.ndarray:
    """Return a mask (m,) of the faces of all bodies that are not inside another body."""
    numbers = np.unique(bodies)
    inner = []
    for body in numbers if len(numbers) > 1 else ():
        mine = faces[bodies == body]
        points = vertices[mine[np.linspace(0, len(mine) - 1, SAMPLES).astype(int), 0]]
        if any((winding_numbers(vertices, faces[bodies == other], points) > 0.5).all()
               for other in numbers if other != body):
            inner.append(body)
    if inner:
        notes.append(f'Dropped {format_count(len(inner), "body", "bodies")} inside another body.')
    return ~np.isin(bodies, inner)


def face_areas(vertices: Array, faces: np.ndarray) -> Array:
    """Return the area (m,) of every face, m^2."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return 0.5 * np.sqrt(np.einsum('ij,ij->i', normal, normal))


def _adjacent_faces(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs (p, 2) of faces that share an edge alone, and if their windings agree (p,)."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind='stable')
    run = np.flatnonzero(np.concatenate([[True], np.diff(key[order]) != 0, [True]]))
    two = run[:-1][np.diff(run) == 2]
    one, other = order[two], order[two + 1]
    return np.stack([one // 3, other // 3], axis=1), start[one] == end[other]
