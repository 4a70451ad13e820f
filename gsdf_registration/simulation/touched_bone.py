# SPDX-License-Identifier: Apache-2.0
"""What is between the tip of a probe and the bone: the ball of the tip, cartilage, soft tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.ball_tip import BallContact, with_ball_tip
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import SimulatedRecording
from gsdf_registration.simulation.surface_errors import cartilage, displaced, soft_tissue


@dataclass(frozen=True, eq=False)
class TouchedBone:
    """
    A bone as a probe meets it.

    vertices, faces : (n, 3) float64, m, and (m, 3) int, closed, outward
    patch : the exposed area
    tip_radius : m, of the ball at the end of the probe; 0 for a sharp tip
    cartilage : whether a part of the exposed area is covered with cartilage
    soft_tissue : m, mean thickness of soft tissue on the whole exposed area
    """

    vertices: Array
    faces: NDArray[np.int64]
    patch: Patch
    tip_radius: float = 0.0
    cartilage: bool = False
    soft_tissue: float = 0.0

    def __post_init__(self) -> None:
        """Raise `InputError` if a length is negative or too large."""
        for name, length in (('radius of the tip', self.tip_radius),
                             ('thickness of soft tissue', self.soft_tissue)):
            if not 0.0 <= length <= 0.01:
                raise InputError(f'the {name} must be 0 to 10 mm, not {1e3 * length:g} mm')

    def touched(self, recording: SimulatedRecording,
                rng: np.random.Generator) -> SimulatedRecording:
        """Return a recording of a sharp tip on the bare bone as this tip makes it on this bone."""
        if self.tip_radius > 0.0:
            recording = with_ball_tip(recording, self.vertices, self.faces, self.patch.approach,
                                      self.tip_radius)
        on_bone = recording.on_bone
        if not on_bone.any() or not (self.cartilage or self.soft_tissue):
            return recording
        places = recording.tips[on_bone]
        height = np.zeros(len(places))
        if self.cartilage:
            height += cartilage(places, rng)
        if self.soft_tissue:
            height += soft_tissue(places, self.soft_tissue, rng)
        shift = np.zeros_like(recording.tips)
        normals = BallContact(self.vertices, self.faces).distance(places)[1]
        shift[on_bone] = height[:, None] * normals
        return displaced(recording, shift)
