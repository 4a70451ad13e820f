# SPDX-License-Identifier: Apache-2.0
"""
The markers of ~/markers: the bone, its zone, points and next places to touch; m, bone frame.

Every function returns all markers of its namespaces, and deletions of those that are no longer
shown. A message is thus complete: markers do not flicker, and a viewer that starts late or misses a
message shows no stale markers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array, from_rt
from msg_adapters.marker_cdr import Marker, Shape

MAX_POINTS = 4000       # more points would overlap
MAX_PATCHES = 5         # number of patches in a message
POINT = 0.0025          # m, diameter of a touched point
LINE = 0.0015           # m, width of the border of the zone
DOT = 0.002             # m, diameter of a point of a point-cloud model
ARROW = 0.03            # m, from the tail to the patch
LETTER = 0.008          # m, height of a capital


def bone(vertices: Array, faces: NDArray[np.int32], colours: Array) -> list[Marker]:
    """
    Return the surface of the bone.

    Parameters
    ----------
    vertices : (n, 3) float, m
    faces : (m, 3) int
        Without faces, the vertices are drawn as dots.
    colours : (n, 3) float
        Colours of the vertices, red green blue in [0, 1].

    """
    if not len(faces):
        return [Marker('bone', 0, Shape.SPHERE_LIST, (DOT, DOT, DOT), points=vertices,
                       colours=_opaque(colours))]
    return [Marker('bone', 0, Shape.TRIANGLE_LIST, points=vertices[faces].reshape(-1, 3),
                   colours=_opaque(colours)[faces].reshape(-1, 4))]


def points(positions: Array, colours: Array) -> list[Marker]:
    """Return touched points (n, 3), m, with colours (n, 3); at most `MAX_POINTS` of them."""
    if not len(positions):
        return [Marker('points', 0)]
    every = -(-len(positions) // MAX_POINTS)
    return [Marker('points', 0, Shape.SPHERE_LIST, (POINT, POINT, POINT),
                   points=positions[::every], colours=_opaque(colours[::every]))]


def border(segments: Array, colour: Array) -> list[Marker]:
    """Return the border of the zone: segments (k, 2, 3), m, of a colour (3,)."""
    if not len(segments):
        return [Marker('zone', 0)]
    return [Marker('zone', 0, Shape.LINE_LIST, (LINE, 0.0, 0.0), points=segments.reshape(-1, 3),
                   colours=colour)]


def patches(positions: Array, normals: Array, radius: float, labels: Sequence[str],
            colour: Array) -> list[Marker]:
    """
    Return the patches to touch next: a disc on the bone with an arrow and a label.

    Parameters
    ----------
    positions, normals : (n, 3) float, m
        On the bone, best first; the first `MAX_PATCHES` are shown.
    radius : float, m, of a disc
    labels : sequence of n str
    colour : (3,) float

    """
    markers = []
    for k in range(MAX_PATCHES):
        if k < len(positions):
            pose = from_rt(_upright(normals[k]), positions[k])
            tail = np.array([[0.0, 0.0, ARROW], [0.0, 0.0, 0.0]])
            label = from_rt(np.eye(3), positions[k] + (ARROW + LETTER) * normals[k])
            markers += [
                Marker('patch', k, Shape.CYLINDER, (2.0 * radius, 2.0 * radius, 0.2 * radius), pose,
                       colours=np.append(colour, 0.7)),
                Marker('patch_arrow', k, Shape.ARROW, (0.1 * ARROW, 0.2 * ARROW, 0.3 * ARROW), pose,
                       points=tail, colours=colour),
                # RViz takes the width of a space from x, as for letters of 1 m if it is 0
                Marker('patch_label', k, Shape.TEXT, (LETTER, 0.0, LETTER), label, colours=colour,
                       text=labels[k])]
        else:
            markers += [Marker(name, k) for name in ('patch', 'patch_arrow', 'patch_label')]
    return markers


def _opaque(colours: Array) -> Array:
    """Return colours (n, 3) with an alpha of one, (n, 4)."""
    return np.column_stack([colours, np.ones(len(colours))])


def _upright(normal: Array) -> Array:
    """Return a rotation (3, 3) that maps z to ``normal``."""
    aside = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(aside, normal)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(normal, x), normal])
