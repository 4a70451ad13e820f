# SPDX-License-Identifier: Apache-2.0
"""A pose that follows as points are added: each time a warm solve, within a millisecond."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.point_filters import has_neighbours
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence, reassess
from gsdf_registration.solver import Neighbourhood, Solution, allow_for_model_error, refine

MOVED = 0.003   # m: farther from where they were found, neighbours are others
FEW = 0.002     # share of the points that moves nothing, and need not be solved for
CORNERS = np.indices((2, 2, 2)).reshape(3, 8).T     # of a box: low or high in each axis


class WarmPose:
    """
    The pose of some points, and then of more.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame, on strokes
    field : of the bone
    solution : of these points, or of nearly these
    config : Config

    """

    def __init__(self, points: Array, field: Field, solution: Solution, config: Config) -> None:
        self.points, self.solution = points, solution
        self.confidence: Confidence | None = None   # to be found by `assess` once in a while
        self._field, self._config = field, config
        self._held = points
        self._settle()

    def _settle(self) -> None:
        """Find all neighbours at the present pose, and solve."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        self._corners = np.array([low, high])[CORNERS, [0, 1, 2]]
        self._T_of_neighbours = self.solution.T_bone_tracker
        self._neighbourhood = Neighbourhood(self.points, self._field, self._T_of_neighbours)
        self._solve(reuse_correction=False)
        self.solution = allow_for_model_error(self.solution, self.points)

    def _solve(self, reuse_correction: bool) -> None:
        self.solution = refine(self.points, self._field, self.solution, self._config.solver,
                               self._neighbourhood.indices, reuse_correction)

    def add(self, points: Array) -> None:
        """
        Take in new points (m, 3), m, tracker frame.

        Points without neighbours are left out, as `density.on_strokes` would leave them; so are
        those beyond ``live.max_points``.  Both have their turn when all points are looked at again.
        A few among many wait for others before it is solved again.
        """
        self._held = np.concatenate([self._held, points])
        room = max(self._config.live.max_points - len(self.points), 0)
        joining = points[has_neighbours(points, self._held)][:room]
        if not len(joining):
            return
        self.points = np.concatenate([self.points, joining])
        self._neighbourhood.add(joining)
        if len(self.points) - len(self.solution.weights) < FEW * len(self.points):
            return
        self._solve(reuse_correction=True)
        if self._moved() > MOVED:
            self._settle()
        if self.confidence is not None:
            self.confidence = reassess(self.confidence, self.solution, self.points)

    def _moved(self) -> float:
        """Return by how much the points have moved since their neighbours were found, m (most)."""
        motion = self.solution.T_bone_tracker - self._T_of_neighbours
        moved = self._corners @ motion[:3, :3].T + motion[:3, 3]
        return float(np.sqrt((moved**2).sum(axis=1).max()))

    @property
    def T_tracker_bone(self) -> Array:
        """The pose of the bone (4, 4), m."""
        return rigid.inverse(self.solution.T_bone_tracker)

    @property
    def covariance(self) -> Array | None:
        """Its covariance (6, 6), REP-103 order; None if the points do not hold the pose."""
        if self.confidence is None:
            return None
        return self.confidence.pose_covariance(self.T_tracker_bone)
