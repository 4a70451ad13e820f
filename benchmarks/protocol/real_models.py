# SPDX-License-Identifier: Apache-2.0
"""Scenarios of models as patients have them, and of probes that are calibrated with an error."""

from __future__ import annotations

import numpy as np

from benchmarks.protocol.cases import bone
from benchmarks.protocol.imperfect_bones import KINDS, imperfect_bone
from gsdf_registration.field import Field
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import SimulatedRecording
from gsdf_registration.simulation.surface_errors import (
    cartilage,
    displaced,
    smooth_error,
    tip_error,
)

TIP_ERROR = 5e-4        # m
# Distance of the surface that is touched from the model, outward, m
OFFSETS = {'model_dilated': -3e-4, 'model_eroded': 3e-4, 'ball_radius_off': 2e-4}
# Standard deviation and length of a smooth error of the model, m
SMOOTH = {f'smooth_{1e3 * sd:g}_{1e3 * length:g}': (sd, length)
          for sd in (3e-4, 5e-4) for length in (0.008, 0.015, 0.03)}
REAL_MODELS = (*KINDS, 'cartilage', *SMOOTH, *OFFSETS, 'tip_off')
# What their users set beside the defaults: they know how accurate probe and model are
SETTINGS = {'mri': {'model.surface_error': 5e-4}, 'tip_off': {'probe.tip_error': TIP_ERROR},
            **{word: {'model.surface_error': sd} for word, (sd, _) in SMOOTH.items()}}


def model_of(path: str, word: str, seed: int) -> Field:
    """Return the model of a bone (path, mm) in the scenario ``word``, of `REAL_MODELS` or empty."""
    return imperfect_bone(path, word, seed) if word in KINDS else bone(path)


def with_deviation(recording: SimulatedRecording, word: str, field: Field, patch: Patch,
                   rng: np.random.Generator) -> SimulatedRecording:
    """
    Return the recording of a bone that deviates from its model, or of a probe that is off.

    Parameters
    ----------
    recording : of the bone of ``field``
    word : of `REAL_MODELS`
    field : of the bone
    patch : the exposed area
    rng : numpy Generator

    """
    if word == 'tip_off':
        return displaced(recording, tip_error(len(recording.tips), TIP_ERROR, patch.approach, rng))
    tips, size = recording.tips, np.zeros(len(recording.tips))
    if word in SMOOTH:
        size = smooth_error(tips, *SMOOTH[word], rng)
    elif word in OFFSETS:
        size[:] = OFFSETS[word]
    elif word == 'cartilage':
        size = cartilage(tips, rng)
    return displaced(recording, size[:, None] * field.sample(tips)[1])
