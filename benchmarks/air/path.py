# SPDX-License-Identifier: Apache-2.0
"""
Where the tip and the shaft of a probe are in the air: between strokes, and above the touched bone.

A hand lifts the tip along the outward normal, moves it to the next stroke and lowers it. The shaft
points away from the bone. Neither enters the bone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, measure

HEIGHT = (0.005, 0.030)     # m, minimum and maximum height of a lift
TILT = np.radians(45.0)     # rad, maximum angle between the shaft and the outward normal
SPEED = 0.15                # m/s, in the air
SHAFT = np.linspace(0.005, 0.1, 20)     # m, distances behind the tip that must be free of bone
SHAFT_RADIUS = 0.002        # m
TRIES = 64                  # directions of the shaft
RAISES = np.arange(0.0, 0.101, 0.01)    # m, by which a way is raised until it is free
ORIENTATION_NOISE = np.radians(0.3)     # rad, standard deviation


@dataclass(frozen=True, eq=False)
class AirPath:
    """
    Measured poses of the probe, tracker frame.

    tips : (k, 3) float64, m, between the strokes, in order
    shafts : (k, 3) float64, unit length, from the tip to the hand
    strokes : (k,) int32, number of the stroke before
    touching_shafts : (n, 3) float64, unit length, for each sample of the recording
    """

    tips: Array
    shafts: Array
    strokes: NDArray[np.int32]
    touching_shafts: Array


def simulate_air(recording: SimulatedRecording, patch: Patch, field: Field,
                 rng: np.random.Generator, tracker: Tracker) -> AirPath:
    """
    Return how the probe was held in a recording and moved between its strokes.

    Parameters
    ----------
    recording : SimulatedRecording
    patch : Patch, bone frame
        The exposed area.
    field : Field
        Of the bone that was touched.
    rng : numpy Generator
    tracker : Tracker

    """
    numbers = np.unique(recording.strokes)
    strokes = [recording.tips[recording.strokes == number] for number in numbers]
    directions = [_direction(tips, patch, field, rng) for tips in strokes]
    ways = [_way(a[-1], b[0], u, v, patch, field, rng, tracker.rate)
            for a, b, u, v in zip(strokes, strokes[1:], directions, directions[1:])]
    T = recording.T_tracker_bone
    tips = np.concatenate([np.empty((0, 3)), *(way[0] for way in ways)])
    shafts = np.concatenate([np.empty((0, 3)), *(way[1] for way in ways)])
    after = np.repeat(numbers[:-1], [len(way[0]) for way in ways])
    touching = np.array(directions)[np.searchsorted(numbers, recording.strokes)]
    return AirPath(measure(transform(T, tips), tracker, rng), _turned(shafts, T, rng), after,
                   _turned(touching, T, rng))


def along_shaft(tips: Array, shafts: Array, distances: Array = SHAFT) -> Array:
    """Return the positions (n * k, 3), m, at ``distances`` (k,), m, behind ``tips`` (n, 3)."""
    return (tips[:, None] + distances[:, None] * shafts[:, None]).reshape(-1, 3)


def _turned(shafts: Array, T_tracker_bone: Array, rng: np.random.Generator) -> Array:
    """Return directions (n, 3) as measured in the tracker frame."""
    noisy = shafts + ORIENTATION_NOISE * rng.normal(size=shafts.shape)
    return (noisy / np.linalg.norm(noisy, axis=1)[:, None]) @ T_tracker_bone[:3, :3].T


def _direction(tips: Array, patch: Patch, field: Field, rng: np.random.Generator) -> Array:
    """Return the direction (3,) of the shaft in a stroke that is the farthest from the bone."""
    normal = field.sample(tips)[1].mean(axis=0) + 0.5 * patch.approach
    normal /= np.linalg.norm(normal)
    cosines = rng.uniform(np.cos(TILT), 1.0, TRIES)
    aside = rng.normal(size=(TRIES, 3))
    aside -= (aside @ normal)[:, None] * normal
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    tries = cosines[:, None] * normal + np.sqrt(1.0 - cosines**2)[:, None] * aside
    some = tips[::max(len(tips) // 8, 1)]
    free = np.array([_clearance(some, np.broadcast_to(u, some.shape), field) for u in tries])
    # the first that is free, as a hand has no reason to choose the best
    return np.asarray(tries[np.argmax(np.minimum(free, 0.0))])


def _clearance(tips: Array, shafts: Array, field: Field) -> float:
    """Return the distance of the shaft from the bone, m, at the place where it is smallest."""
    return float(field.sample(along_shaft(tips, shafts))[0].min()) - SHAFT_RADIUS


def _way(a: Array, b: Array, u: Array, v: Array, patch: Patch, field: Field,
         rng: np.random.Generator, rate: float) -> tuple[Array, Array]:
    """
    Return tips and shafts (k, 3) from ``a`` with shaft ``u`` to ``b`` with shaft ``v``.

    The way is raised along the approach until tip and shaft are free of bone; it is empty if they
    are not at any height.
    """
    normals = field.sample(np.array([a, b]))[1]
    heights = rng.uniform(*HEIGHT, 2)
    for rise in RAISES:
        corners = np.array([a, a + heights[0] * normals[0] + rise * patch.approach,
                            b + heights[1] * normals[1] + rise * patch.approach, b])
        tips, share = _sampled(corners, SPEED / rate)
        shafts = (1.0 - share)[:, None] * u + share[:, None] * v
        shafts /= np.linalg.norm(shafts, axis=1)[:, None]
        inner = slice(1, -1)
        if (field.sample(tips[inner])[0].min() > 0.0
                and _clearance(tips[inner], shafts[inner], field) > 0.0):
            return tips, shafts
    return np.empty((0, 3)), np.empty((0, 3))


def _sampled(corners: Array, step: float) -> tuple[Array, Array]:
    """Return samples (k, 3) along the polyline ``corners``, and the share of the way (k,)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], max(int(lengths[-1] / step), 4))
    tips = np.column_stack([np.interp(at, lengths, corners[:, axis]) for axis in range(3)])
    return tips, at / lengths[-1]
