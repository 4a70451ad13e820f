# SPDX-License-Identifier: Apache-2.0
"""
What segmentation and export do to a mesh, undone.

Every step takes ``vertices`` (n, 3) float64 and ``faces`` (m, 3) int64 and appends a sentence to
``notes`` if it had to change anything. Bodies are the sets of faces connected over shared edges,
numbered in ``bodies`` (m,).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gsdf_registration.common.formatting import counted
from gsdf_registration.common.rigid import Array
from gsdf_registration.mesh.winding import winding_numbers

SAME_PLACE = 1e-6       # vertices closer than this share of the extent are one
SPECK = 0.01            # bodies with less than this share of the largest one's area are noise
PROBES = 24             # places where the orientation of a body is tested


def merge_vertices(vertices: Array, faces: np.ndarray,
                   notes: list[str]) -> tuple[Array, np.ndarray]:
    """Merge vertices in the same place; the first one's coordinates stay."""
    low = vertices.min(axis=0)
    close = SAME_PLACE * float(np.ptp(vertices, axis=0).max())
    # first by cells of that size, which bounds the neighbours of each; then across their walls
    cell = ((vertices - low) / close).astype(np.int64)
    _, first, label = np.unique((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2],
                                return_index=True,
                                return_inverse=True)
    representative = first[label.ravel()]
    pairs = cKDTree(vertices[first]).query_pairs(close, output_type='ndarray')
    if len(pairs):
        _, group = _components(pairs, len(first))
        lowest = np.full(len(first), len(vertices))
        np.minimum.at(lowest, group, first)
        representative = lowest[group][label.ravel()]
    merged = int((representative != np.arange(len(vertices))).sum())
    if merged:
        notes.append(f'Merged {counted(merged, "duplicate vertex", "duplicate vertices")}.')
    return drop_unused_vertices(vertices, representative[faces])


def drop_unused_vertices(vertices: Array, faces: np.ndarray) -> tuple[Array, np.ndarray]:
    """Drop the vertices no face uses; the others keep their order."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def drop_bad_faces(vertices: Array, faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """Drop faces without an area and all but one of equal faces, however wound."""
    extent = float(np.ptp(vertices, axis=0).max())
    flat = areas(vertices, faces) <= 1e-12 * extent**2
    if flat.any():
        notes.append(f'Dropped {counted(int(flat.sum()), "face")} without an area.')
        faces = faces[~flat]
    low, middle, high = np.sort(faces, axis=1).T
    order = np.lexsort((high, middle, low))
    repeated = np.zeros(len(faces), dtype=bool)
    same = (np.diff(low[order]) == 0) & (np.diff(middle[order]) == 0) & (np.diff(high[order]) == 0)
    repeated[order[1:][same]] = True
    if repeated.any():
        notes.append(f'Dropped {counted(int(repeated.sum()), "duplicate face")}.')
    return faces[~repeated]


def wind_consistently(faces: np.ndarray, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """
    Wind the faces of each body alike and return them with their ``bodies``.

    Each face is taken twice, as it is and flipped; across every edge of just two faces the windings
    that agree are joined.  The set of windings that hangs together with the first face as it is, is
    a consistent one; there is no order to walk in.
    """
    pairs, agree = _neighbours(faces)
    m = len(faces)
    count, bodies = _components(pairs, m)
    if agree.all():
        return faces, bodies
    left, right = pairs.T
    other = np.where(agree, right, right + m)
    _, winding = _components(
        np.concatenate(
            [np.stack([left, other], axis=1),
             np.stack([left + m, (other + m) % (2 * m)], axis=1)]), 2 * m)
    first = np.full(count, m)
    np.minimum.at(first, bodies, np.arange(m))
    flipped = winding[:m] != winding[first[bodies]]
    # the fewer faces of a body are the flipped ones
    minority = np.bincount(bodies, flipped) * 2 > np.bincount(bodies)
    flipped ^= minority[bodies]
    notes.append(f'Turned {counted(int(flipped.sum()), "flipped face")} to fit the neighbours.')
    return np.where(flipped[:, None], faces[:, ::-1], faces), bodies


def large_bodies(vertices: Array, faces: np.ndarray, bodies: np.ndarray,
                 notes: list[str]) -> np.ndarray:
    """Return which faces (m,) belong to bodies that are more than specks."""
    area = np.bincount(bodies, areas(vertices, faces))
    specks = area < SPECK * area.max()
    if specks.any():
        notes.append(f'Dropped {counted(int(specks.sum()), "loose speck")}.')
    return ~specks[bodies]


def orient_outward(vertices: Array, faces: np.ndarray, bodies: np.ndarray,
                   notes: list[str]) -> np.ndarray:
    """
    Turn the bodies that are inside out.

    On a face the winding number of a body is the mean of both sides: about +1/2 if the face looks
    outward, -1/2 if inward, and nearly so if there are holes (Jacobson et al., SIGGRAPH 2013).
    """
    turned = 0
    faces = faces.copy()
    for body in np.unique(bodies):
        mine = np.flatnonzero(bodies == body)
        area = np.cumsum(areas(vertices, faces[mine]))
        spread = np.searchsorted(area, (np.arange(PROBES) + 0.5) / PROBES * area[-1])
        centres = vertices[faces[mine[spread]]].mean(axis=1)
        if winding_numbers(vertices, faces[mine], centres).sum() < 0.0:
            faces[mine] = faces[mine, ::-1]
            turned += 1
    if turned:
        count = counted(len(np.unique(bodies)), 'body', 'bodies')
        notes.append(f'Turned what was inside out: {turned} of {count}.')
    return faces


def outer_bodies(vertices: Array, faces: np.ndarray, bodies: np.ndarray,
                 notes: list[str]) -> np.ndarray:
    """Return which faces (m,) are not of a body wholly inside another, where no probe can go."""
    names = np.unique(bodies)
    inner = []
    for body in names if len(names) > 1 else ():
        mine = faces[bodies == body]
        probes = vertices[mine[np.linspace(0, len(mine) - 1, PROBES).astype(int), 0]]
        if any((winding_numbers(vertices, faces[bodies == other], probes) > 0.5).all()
               for other in names if other != body):
            inner.append(body)
    if inner:
        notes.append(f'Dropped {counted(len(inner), "body", "bodies")} inside another one.')
    return ~np.isin(bodies, inner)


def areas(vertices: Array, faces: np.ndarray) -> Array:
    """Return the area of every face, (m,)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return 0.5 * np.sqrt(np.einsum('ij,ij->i', normal, normal))


def _neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs (p, 2) of faces that alone share an edge, and if they are wound alike (p,)."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind='stable')
    run = np.flatnonzero(np.concatenate([[True], np.diff(key[order]) != 0, [True]]))
    two = run[:-1][np.diff(run) == 2]
    one, other = order[two], order[two + 1]
    return np.stack([one // 3, other // 3], axis=1), start[one] == end[other]


def _components(pairs: np.ndarray, n: int) -> tuple[int, np.ndarray]:
    """Return number and labels (n,) of the connected components of a graph with edges ``pairs``."""
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])),
                      shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return count, label
