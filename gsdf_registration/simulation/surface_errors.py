# SPDX-License-Identifier: Apache-2.0
"""
Touches of a bone that deviates from its model, or by a probe that is calibrated with an error.

Each function returns a displacement of the tip at every sample; `displaced` applies it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gsdf_registration.common.rigid import Array, rotation_exp
from gsdf_registration.simulation.correlated_noise import correlated_noise
from gsdf_registration.simulation.probe import SimulatedRecording

WAVES = 200             # random Fourier features that approximate a Gaussian process
CARTILAGE = 0.0008      # m, thickness
CARTILAGE_EDGE = 0.004  # m, over which cartilage becomes thin
COVERED = (0.3, 0.6)    # smallest and largest share of the touched area with cartilage
TISSUE_LENGTH = 0.010   # m, over which the thickness of soft tissue is correlated
TILT = 0.3              # rad, standard deviation of the tilt of a tool about each axis
SPIN = 0.5              # rad, standard deviation of its rotation about its own axis
MEMORY = 100.0          # samples over which the orientation of a tool is correlated


def displaced(recording: SimulatedRecording, shift: Array) -> SimulatedRecording:
    """Return a recording whose tips are displaced by ``shift`` (n, 3), m, bone axes."""
    R = recording.T_tracker_bone[:3, :3]
    return replace(recording, tips=recording.tips + shift,
                   positions=recording.positions + shift @ R.T)


def smooth_error(places: Array, sd: float, length: float, rng: np.random.Generator) -> Array:
    """
    Return a Gaussian process (n,), m, at ``places`` (n, 3), m, with a Gaussian covariance.

    By random Fourier features (Rahimi and Recht 2007). ``sd``, ``length``: m, standard deviation
    and the distance over which the error is correlated.
    """
    waves = rng.normal(0.0, 1.0 / length, (WAVES, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, WAVES)
    return np.asarray(sd * np.sqrt(2.0 / WAVES) * np.cos(places @ waves.T + phases).sum(axis=1))


def cartilage(places: Array, rng: np.random.Generator) -> Array:
    """Return the thickness of cartilage (n,), m, over a part of ``places`` (n, 3), m."""
    away = np.linalg.norm(places - places[rng.integers(len(places))], axis=1)
    radius = np.quantile(away, rng.uniform(*COVERED))
    return np.asarray(CARTILAGE * np.clip((radius - away) / CARTILAGE_EDGE, 0.0, 1.0))


def soft_tissue(places: Array, thickness: float, rng: np.random.Generator) -> Array:
    """
    Return the thickness of soft tissue (n,), m, under the tip at ``places`` (n, 3), m.

    It varies smoothly about ``thickness``, m, with half of it as standard deviation.
    """
    return np.maximum(thickness + smooth_error(places, 0.5 * thickness, TISSUE_LENGTH, rng), 0.0)


def tip_error(count: int, size: float, approach: Array, rng: np.random.Generator) -> Array:
    """
    Return the displacement (count, 3), m, bone axes, by a wrong tip calibration.

    It is fixed in the frame of the tool, whose axis stays around ``approach``.

    Parameters
    ----------
    count : int, number of samples
    size : float, m, length of the error, of any direction
    approach : (3,) float, unit length, from the bone toward the hand

    """
    error = rng.normal(size=3)
    error *= size / np.linalg.norm(error)
    x, y, spin = (np.array([TILT, TILT, SPIN]) * correlated_noise((count, 3), MEMORY, rng)).T
    aside = np.linalg.svd(approach[None])[2][1:]        # two axes across the approach
    return np.array([rotation_exp(a * aside[0] + b * aside[1])
                     @ rotation_exp(c * approach) @ error for a, b, c in zip(x, y, spin)])
