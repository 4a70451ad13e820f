# SPDX-License-Identifier: Apache-2.0
"""A pose that is updated as points are added, by a warm-started solve in about a millisecond."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.point_filters import has_neighbours
from gsdf_registration.common.rests import find_rests
from gsdf_registration.common.result import LandmarkFit
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence, assess, reassess
from gsdf_registration.registration.landmark_evidence import fuse
from gsdf_registration.registration.point_selection import evenly_spread
from gsdf_registration.solver import (
    Neighbourhood,
    Solution,
    allow_for_model_error,
    before,
    refine,
)

# m; after a larger motion of a point the neighbourhoods are computed again
NEIGHBOURHOOD_TOLERANCE = 0.003
# New points that are a smaller share of all points than this wait for more before the next solve
MIN_NEW_SHARE = 0.002
MAX_NEW = 2000          # points per call
# Points among which neighbours are searched; only with many outliers there are more than those used
MAX_CLOUD = 20_000
RECENT = 300            # points before the new ones among which a rest is looked for
CORNERS = np.indices((2, 2, 2)).reshape(3, 8).T     # of a box: low or high in each axis


class WarmPose:
    """
    A solution that is refined as points are added.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
        On strokes first, then the touches of ``solution``.
    field : of the bone
    solution : of these points, or of most of them
    config : Config
    landmarks : Landmarks
        With standard deviations.

    """

    def __init__(self, points: Array, field: Field, solution: Solution, config: Config,
                 landmarks: Landmarks = NO_LANDMARKS) -> None:
        self.points, self.solution = points, solution
        self.confidence: Confidence | None = None   # set by a full assessment, then updated
        self.landmark_fits: tuple[LandmarkFit, ...] = ()
        self._field, self._config, self._landmarks = field, config, landmarks
        self._cloud = points        # with the isolated points added since
        self._restart()

    def _restart(self) -> None:
        """Compute all neighbourhoods at the present pose, and solve."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        self._corners = np.array([low, high])[CORNERS, [0, 1, 2]]
        self._T_at_restart = self.solution.T_bone_tracker
        self._neighbourhood = Neighbourhood(before(self.solution.touches, self.points), self._field,
                                            self._T_at_restart)
        self._solve(reuse_correction=False)
        self.solution = allow_for_model_error(self.solution, self.points, self._field,
                                              self._config.model.surface_error)
        if not len(self._landmarks):
            return
        alone = assess(self.solution, self.points, self._neighbourhood.indices,
                       self._config.probe.tip_error)
        if alone is not None:
            self.solution, self.confidence, self.landmark_fits = fuse(
                self.solution, alone, self.points, self._field, self._landmarks)

    def _solve(self, reuse_correction: bool) -> None:
        self.solution = refine(self.points, self._field, self.solution, self._config.solver,
                               self._neighbourhood.indices, reuse_correction)

    def add(self, points: Array) -> None:
        """
        Add points (m, 3), m, tracker frame.

        Isolated points and those beyond ``live.max_points`` are not used; the next full assessment
        considers them again. It also finds the touches: a tip at rest adds nothing here, nor do
        points between touches. At most `MAX_NEW` points of a call are considered.
        """
        room, strokes = self._config.live.max_points - len(self.points), len(self._neighbourhood)
        if room <= 0 or not strokes or not len(points):
            return
        points = points[evenly_spread(np.arange(len(points)), MAX_NEW)]
        self._cloud = np.concatenate([self._cloud[-MAX_CLOUD:], points])
        recent = self._cloud[-len(points) - RECENT:]
        new = points[find_rests(recent).which[-len(points):] < 0]
        new = new[has_neighbours(new, self._cloud)][:room]
        if not len(new):
            return
        self.points = np.concatenate([self.points[:strokes], new, self.points[strokes:]])
        self._neighbourhood.add(new)
        if len(self.points) - len(self.solution.weights) < MIN_NEW_SHARE * len(self.points):
            return
        self._solve(reuse_correction=True)
        if self._motion() > NEIGHBOURHOOD_TOLERANCE:
            self._restart()
        if self.confidence is not None:
            self.confidence = reassess(self.confidence, self.solution, self.points)

    def _motion(self) -> float:
        """Return the largest motion of a point since the neighbourhoods were computed, m."""
        motion = self.solution.T_bone_tracker - self._T_at_restart
        moved = self._corners @ motion[:3, :3].T + motion[:3, 3]
        return float(np.sqrt((moved**2).sum(axis=1).max()))

    @property
    def T_tracker_bone(self) -> Array:
        """Pose of the bone (4, 4), m."""
        return rigid.inverse(self.solution.T_bone_tracker)

    @property
    def covariance(self) -> Array | None:
        """Covariance (6, 6), REP-103 order; None if the points do not constrain the pose."""
        if self.confidence is None:
            return None
        return self.confidence.pose_covariance(self.T_tracker_bone)
