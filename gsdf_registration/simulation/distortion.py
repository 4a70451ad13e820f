# SPDX-License-Identifier: Apache-2.0
"""The smooth distortion of an electromagnetic tracker near metal: of positions and orientations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.rigid import Array

WAVELENGTH = 0.4        # m, about


@dataclass(frozen=True, eq=False)
class Distortion:
    """
    A constant displacement, one plane wave along each axis of the tracker.

    rms : float, m, of the length of the displacement
    waves : (3, 3) float64, 1/m, one row for each axis
    phases : (3,) float64, rad
    """

    rms: float
    waves: Array
    phases: Array

    @classmethod
    def random(cls, rms: float, rng: np.random.Generator) -> Distortion:
        """Return a random distortion."""
        waves = rng.normal(0.0, 2.0 * np.pi / WAVELENGTH, (3, 3))
        return cls(rms, waves, rng.uniform(0.0, 2.0 * np.pi, 3))

    def displacement(self, positions: Array) -> Array:
        """Return the displacement (n, 3), m, at ``positions`` (n, 3), m, tracker frame."""
        return np.asarray(self.rms * np.sqrt(2.0 / 3.0)
                          * np.sin(positions @ self.waves.T + self.phases))

    def rotation(self, positions: Array) -> Array:
        """
        Return the rotation vector (n, 3), rad, of a small body at ``positions`` (n, 3), m.

        It is half the curl of the displacement, as of a body in a deformed medium.
        """
        slope = (self.rms * np.sqrt(2.0 / 3.0) * np.cos(positions @ self.waves.T + self.phases))
        gradient = slope[:, :, None] * self.waves       # of the displacement along each axis
        return 0.5 * np.stack([gradient[:, 2, 1] - gradient[:, 1, 2],
                               gradient[:, 0, 2] - gradient[:, 2, 0],
                               gradient[:, 1, 0] - gradient[:, 0, 1]], axis=1)
