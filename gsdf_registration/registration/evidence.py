# SPDX-License-Identifier: Apache-2.0
"""What is known of the pose besides the points on the surface."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as item

from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration import free_space, landmark_evidence

__all__ = ['Evidence', 'Landmarks']


@dataclass(frozen=True, eq=False)
class Evidence:
    """
    Landmarks and free space.

    landmarks : Landmarks
    air : (m, 3) float, m, tracker frame, where the tip or the shaft has been while not on the bone,
        one position for each place, see `free_space.places`
    """

    landmarks: Landmarks = NO_LANDMARKS
    air: Array = item(default_factory=lambda: free_space.NO_PLACES)

    def log_likelihood(self, T_bone_tracker: Array, field: Field) -> float:
        """Return the log-likelihood of a pose (4, 4), up to a constant."""
        return (free_space.log_likelihood(self.air, T_bone_tracker, field)
                + landmark_evidence.log_likelihood(self.landmarks.measured, T_bone_tracker))
