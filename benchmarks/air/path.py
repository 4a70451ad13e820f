# SPDX-License-Identifier: Apache-2.0
"""Where the tip and the shaft of a probe are between the strokes of a simulated recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.simulation.air import shaft_direction, way_between
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, measure

SPEED = 0.15                # m/s, in the air
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
    directions = [shaft_direction(tips, patch, field.sample, rng) for tips in strokes]

    def pace(length: float) -> Array:
        return np.linspace(0.0, length, max(int(length / (SPEED / tracker.rate)), 4))
    ways = [way_between((a[-1], b[0]), (u, v), patch, field.sample, rng, pace)
            for a, b, u, v in zip(strokes, strokes[1:], directions, directions[1:])]
    T = recording.T_tracker_bone
    tips = np.concatenate([np.empty((0, 3)), *(way[0] for way in ways)])
    shafts = np.concatenate([np.empty((0, 3)), *(way[1] for way in ways)])
    after = np.repeat(numbers[:-1], [len(way[0]) for way in ways])
    touching = np.array(directions)[np.searchsorted(numbers, recording.strokes)]
    return AirPath(measure(transform(T, tips), tracker, rng), _turned(shafts, T, rng), after,
                   _turned(touching, T, rng))


def _turned(shafts: Array, T_tracker_bone: Array, rng: np.random.Generator) -> Array:
    """Return directions (n, 3) as measured in the tracker frame."""
    noisy = shafts + ORIENTATION_NOISE * rng.normal(size=shafts.shape)
    return (noisy / np.linalg.norm(noisy, axis=1)[:, None]) @ T_tracker_bone[:3, :3].T
