# SPDX-License-Identifier: Apache-2.0
"""Simulate single touches: the tip rests at one place after another and moves through the air."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.simulation.correlated_noise import correlated_noise
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, measure


@dataclass(frozen=True)
class Touching:
    """
    How the probe is touched down.

    dwell : (float, float), s, shortest and longest rest
    tremor : float, m, standard deviation of the hand at rest along each axis, correlated over 0.1 s
    lift : (float, float), m, height of the tip above the bone between two touches
    speed : float, m/s, mean in the air
    soft_tissue : float, share of the touches that are off the bone
    off : (float, float), m, distance of these from the bone
    """

    dwell: tuple[float, float] = (0.3, 2.0)
    tremor: float = 5e-5
    lift: tuple[float, float] = (0.01, 0.03)
    speed: float = 0.12
    soft_tissue: float = 0.0
    off: tuple[float, float] = (0.002, 0.005)


OPTICAL = Tracker()


def touched_places(patch: Patch, count: int, rng: np.random.Generator,
                   touching: Touching = Touching()) -> tuple[Array, Array]:
    """Return the places of ``count`` touches (count, 3), m, bone frame, and their heights, m."""
    places, faces = patch.random_points(count, rng)
    height = np.zeros(count)
    soft = rng.permutation(count)[:round(touching.soft_tissue * count)]
    height[soft] = rng.uniform(*touching.off, len(soft))
    return places + height[:, None] * patch.normals[faces], height


def simulate_touches(patch: Patch, count: int, rng: np.random.Generator, *,
                     tracker: Tracker = OPTICAL, touching: Touching = Touching(),
                     T_tracker_bone: Array | None = None) -> SimulatedRecording:
    """
    Simulate a probe that touches a patch at ``count`` random places, one after another.

    Samples at rest have the kind `Kind.RESTING`, or `Kind.SOFT_TISSUE` off the bone; those in the
    air `Kind.LIFT_OFF`. The stroke number is the index of the touch.
    """
    places, height = touched_places(patch, count, rng, touching)
    tips, kinds, strokes = [], [], []
    for k in range(count):
        rest = max(round(rng.uniform(*touching.dwell) * tracker.rate), 1)
        on = Kind.SOFT_TISSUE if height[k] > 0.0 else Kind.RESTING
        shake = touching.tremor * correlated_noise((rest, 3), 0.1 * tracker.rate, rng)
        parts = [(places[k] + shake, on)]
        if k + 1 < count:
            parts.append((_hop(places[k], places[k + 1], patch.approach, tracker, touching, rng),
                          Kind.LIFT_OFF))
        for part, kind in parts:
            tips.append(part)
            kinds.append(np.full(len(part), kind, dtype=np.uint8))
            strokes.append(np.full(len(part), k, dtype=np.int32))
    T = np.eye(4) if T_tracker_bone is None else np.asarray(T_tracker_bone, dtype=np.float64)
    path = np.concatenate(tips)
    return SimulatedRecording(np.arange(len(path)) / tracker.rate,
                              measure(transform(T, path), tracker, rng), path,
                              np.concatenate(kinds), np.concatenate(strokes), T)


def _hop(a: Array, b: Array, approach: Array, tracker: Tracker, touching: Touching,
         rng: np.random.Generator) -> Array:
    """Return the samples (n, 3) on an arc from ``a`` to ``b``, with smooth start and end."""
    lift = rng.uniform(*touching.lift)
    length = float(np.linalg.norm(b - a)) + 2.0 * lift
    n = max(round(length / touching.speed * tracker.rate), 3)
    s = (np.arange(1, n) / n)[:, None]
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)      # least jerk (Flash and Hogan 1985)
    return a + (b - a) * s + lift * np.sin(np.pi * s) * approach
