# SPDX-License-Identifier: Apache-2.0
"""
How a probe is held on a bone, and how it moves through the air between two strokes.

A hand lifts the tip along the outward normal, moves it to the next stroke and lowers it. The shaft
points away from the bone. Neither enters the bone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.patch import Patch

HEIGHT = (0.005, 0.030)     # m, minimum and maximum height of a lift
TILT = np.radians(45.0)     # rad, maximum angle between the shaft and the outward normal
SHAFT = np.linspace(0.005, 0.1, 20)     # m, distances behind the tip that must be free of bone
SHAFT_RADIUS = 0.002        # m
TRIES = 64                  # directions of the shaft
RAISES = np.arange(0.0, 0.101, 0.01)    # m, by which a way is raised until it is free

# positions (n, 3), m, bone frame -> signed distances (n,), m, and outward normals (n, 3)
Distance = Callable[[Array], tuple[Array, Array]]
# length of a way, m -> where on it its samples are (k,), m, from 0 to the length
Pace = Callable[[float], Array]


def along_shaft(tips: Array, shafts: Array, distances: Array = SHAFT) -> Array:
    """Return the positions (n * k, 3), m, at ``distances`` (k,), m, behind ``tips`` (n, 3)."""
    return (tips[:, None] + distances[:, None] * shafts[:, None]).reshape(-1, 3)


def shaft_direction(tips: Array, patch: Patch, distance: Distance,
                    rng: np.random.Generator) -> Array:
    """
    Return a direction (3,) of the shaft in a stroke (n, 3) that keeps it out of the bone.

    If there is none among `TRIES` random ones, it is the one that enters the bone least.
    """
    normal = distance(tips)[1].mean(axis=0) + 0.5 * patch.approach
    normal /= np.linalg.norm(normal)
    cosines = rng.uniform(np.cos(TILT), 1.0, TRIES)
    aside = rng.normal(size=(TRIES, 3))
    aside -= (aside @ normal)[:, None] * normal
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    tries = cosines[:, None] * normal + np.sqrt(1.0 - cosines**2)[:, None] * aside
    some = tips[::max(len(tips) // 8, 1)]
    clearances = []
    for direction in tries:     # the first that is free: a hand has no reason to choose the best
        clearances.append(_clearance(some, np.broadcast_to(direction, some.shape), distance))
        if clearances[-1] >= 0.0:
            break
    return np.asarray(tries[np.argmax(clearances)])


def way_between(ends: tuple[Array, Array], shafts: tuple[Array, Array], patch: Patch,
                distance: Distance, rng: np.random.Generator, pace: Pace) -> tuple[Array, Array]:
    """
    Return tips (k, 3), m, and shafts (k, 3) on the way from one stroke to the next.

    The way is raised along the approach until tip and shaft are free of bone; it is empty if they
    are not at any height.

    Parameters
    ----------
    ends : two (3,) float, m, end of a stroke and start of the next, bone frame
    shafts : two (3,) float, unit length, directions of the shaft in both
    patch : Patch
    distance : Distance
        To the bone.
    rng : numpy Generator
    pace : Pace
        Where the samples are on a way of a given length.

    """
    (a, b), (u, v) = ends, shafts
    normals = distance(np.array([a, b]))[1]
    heights = rng.uniform(*HEIGHT, 2)
    for rise in RAISES:
        corners = np.array([a, a + heights[0] * normals[0] + rise * patch.approach,
                            b + heights[1] * normals[1] + rise * patch.approach, b])
        tips, share = _sampled(corners, pace)
        directions = (1.0 - share)[:, None] * u + share[:, None] * v
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        inner = slice(1, -1)
        if (distance(tips[inner])[0].min() > 0.0
                and _clearance(tips[inner], directions[inner], distance) > 0.0):
            return tips, directions
    return np.empty((0, 3)), np.empty((0, 3))


def _clearance(tips: Array, shafts: Array, distance: Distance) -> float:
    """Return the distance of the shaft from the bone, m, at the place where it is smallest."""
    return float(distance(along_shaft(tips, shafts))[0].min()) - SHAFT_RADIUS


def _sampled(corners: Array, pace: Pace) -> tuple[Array, Array]:
    """Return samples (k, 3) along the polyline ``corners``, and the share of the way (k,)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = pace(float(lengths[-1]))
    tips = np.column_stack([np.interp(at, lengths, corners[:, axis]) for axis in range(3)])
    return tips, at / lengths[-1]
