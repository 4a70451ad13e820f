# SPDX-License-Identifier: Apache-2.0
"""Recordings of single touches, and of a tip that rests before, between or after the strokes."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, measure
from gsdf_registration.simulation.touches import Touching, touched_places

DURATION = (1.0, 120.0)     # s, of a rest


def single_touches(patch: Patch, count: int, soft_tissue: float, tracker: Tracker,
                   T_tracker_bone: Array, rng: np.random.Generator) -> SimulatedRecording:
    """Return ``count`` touches, one point each, of which a share is 2 to 5 mm off the bone."""
    tips, height = touched_places(patch, count, rng, Touching(soft_tissue=soft_tissue))
    kinds = np.where(height > 0.0, Kind.SOFT_TISSUE, Kind.RESTING).astype(np.uint8)
    positions = measure(rigid.transform(T_tracker_bone, tips), tracker, rng)
    return SimulatedRecording(np.arange(count, dtype=np.float64), positions, tips, kinds,
                              np.arange(count, dtype=np.int32), T_tracker_bone)


def with_rest(recording: SimulatedRecording, patch: Patch, off: tuple[float, float],
              tracker: Tracker, rng: np.random.Generator) -> SimulatedRecording:
    """
    Return a recording in which the tip rests for 1 s to 2 min, m ``off`` the bone (range).

    It rests before, between or after the strokes. The samples are of the kind `Kind.SOFT_TISSUE`
    even on the bone, as they are one piece of evidence.
    """
    place, face = patch.random_points(1, rng)
    place = place + rng.uniform(*off) * patch.normals[face]
    seconds = np.exp(rng.uniform(*np.log(DURATION)))
    tips = np.repeat(place, max(round(seconds * tracker.rate), 1), axis=0)
    positions = measure(rigid.transform(recording.T_tracker_bone, tips), tracker, rng)
    breaks = np.flatnonzero(np.diff(recording.strokes)) + 1
    total = len(recording.stamps)
    at = int(rng.choice([0, total, rng.choice(breaks) if len(breaks) else total]))
    strokes = np.insert(recording.strokes + (np.arange(total) >= at), at,
                        np.full(len(tips), recording.strokes[at - 1] + 1 if at else 0), axis=0)
    return SimulatedRecording(
        np.arange(total + len(tips)) / tracker.rate,
        np.insert(recording.positions, at, positions, axis=0),
        np.insert(recording.tips, at, tips, axis=0),
        np.insert(recording.kinds, at, np.full(len(tips), Kind.SOFT_TISSUE, dtype=np.uint8)),
        strokes.astype(np.int32), recording.T_tracker_bone)
