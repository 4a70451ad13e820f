# SPDX-License-Identifier: Apache-2.0
"""
Tell the bones of a mesh apart, and choose one of them.

A body is a set of faces connected by shared edges. Bodies that intersect are one bone, as the parts
of a model that was put together. The bones are numbered from 1 in the order of their area.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.components import components
from gsdf_registration.common.formatting import format_length
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.mesh.repair import face_areas
from gsdf_registration.mesh.winding import winding_numbers

SAMPLES = 200       # vertices of a body that are tested for lying in another
LISTED = 6          # bones that a message lists
CHOICES = 'a number, largest or all'


def choose_bone(vertices: Array, faces: np.ndarray, bodies: np.ndarray, wanted: str) -> np.ndarray:
    """
    Return a mask (m,) of the faces of the chosen bone.

    Parameters
    ----------
    vertices : (n, 3) float64, m
    faces : (m, 3) int64, oriented outward
    bodies : (m,) int, number of the body of each face
    wanted : str
        Number of a bone, 'largest', 'all', or empty: the only one.

    Raises
    ------
    InputError
        If there are several bones and none is chosen, or the choice is not valid.

    """
    bones = _numbered(vertices, faces, bodies)
    count = int(bones.max())
    word = wanted.strip().lower()
    if word == 'all' or (not word and count == 1):
        return np.ones(len(faces), dtype=bool)
    number = 1 if word == 'largest' else int(word) if word.isdigit() else 0
    if word and not number:
        raise InputError(f'model.body (--body) must be {CHOICES}, not {wanted!r}')
    if not word or number > count:
        what = f'no body {number}' if word else f'{count} bodies'
        raise InputError(f'the model has {what}: choose a bone with --body N (model.body), or '
                         f'--body largest: {_listed(vertices, faces, bones)}')
    return bones == number


def _numbered(vertices: Array, faces: np.ndarray, bodies: np.ndarray) -> np.ndarray:
    """Return the number (m,) of the bone of each face, 1 for the largest area."""
    numbers, index = np.unique(bodies, return_inverse=True)
    pairs = [(i, j) for i in range(len(numbers)) for j in range(i)
             if _intersect(vertices, faces[index == i], faces[index == j])]
    links = np.reshape(pairs, (-1, 2)).astype(np.int64)
    _, group = components(links, len(numbers))
    area = np.bincount(group[index], face_areas(vertices, faces))
    rank = np.empty(len(area), dtype=np.int64)
    rank[np.argsort(-area, kind='stable')] = np.arange(1, len(area) + 1)
    return rank[group[index]]


def _intersect(vertices: Array, one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether vertices of one body lie in the other."""
    return _enters(vertices, one, other) or _enters(vertices, other, one)


def _enters(vertices: Array, body: np.ndarray, other: np.ndarray) -> bool:
    points, corners = vertices[np.unique(body)], vertices[np.unique(other)]
    near = points[((points > corners.min(axis=0)) & (points < corners.max(axis=0))).all(axis=1)]
    if not len(near):
        return False
    sampled = near[np.unique(np.linspace(0, len(near) - 1, SAMPLES).astype(int))]
    return bool((winding_numbers(vertices, other, sampled) > 0.5).any())


def _listed(vertices: Array, faces: np.ndarray, bones: np.ndarray) -> str:
    """Return number, area and size of the largest bones."""
    count = int(bones.max())
    lines = []
    for number in range(1, min(count, LISTED) + 1):
        part = faces[bones == number]
        area = 1e4 * face_areas(vertices, part).sum()
        extent = float(np.ptp(vertices[part].reshape(-1, 3), axis=0).max())
        # + 0.0: no negative zero
        centre = np.round(1e3 * vertices[part].reshape(-1, 3).mean(axis=0)) + 0.0
        lines.append(f'{number} ({area:.0f} cm2, {format_length(extent)} long, around '
                     f'{centre[0]:.0f} {centre[1]:.0f} {centre[2]:.0f} mm)')
    return ', '.join(lines) + (f' and {count - LISTED} smaller' if count > LISTED else '')
