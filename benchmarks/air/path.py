# SPDX-License-Identifier: Apache-2.0
"""Where the tip and the shaft of a probe are measured on the bone and between its strokes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, measure
from gsdf_registration.simulation.tool_motion import carried

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


def measured_path(recording: SimulatedRecording, patch: Patch, field: Field,
                  rng: np.random.Generator, tracker: Tracker) -> AirPath:
    """
    Return how the probe was held in a recording and moved between its strokes.

    Parameters
    ----------
    recording : SimulatedRecording
        Without interference.
    patch : Patch, bone frame
        The exposed area.
    field : Field
        Of the bone that was touched.
    rng : numpy Generator
    tracker : Tracker

    """
    motion = carried(recording, patch, field.sample, tracker.rate, rng)
    air, T = motion.kinds == Kind.LIFT_OFF, recording.T_tracker_bone
    tips = measure(transform(T, motion.tips[air]), tracker, rng)
    noisy = motion.shafts + ORIENTATION_NOISE * rng.normal(size=motion.shafts.shape)
    shafts = (noisy / np.linalg.norm(noisy, axis=1)[:, None]) @ T[:3, :3].T
    return AirPath(tips, shafts[air], motion.strokes[air], shafts[~air])
