# SPDX-License-Identifier: Apache-2.0
"""The first guesses that methods are given which need one."""

from __future__ import annotations

import zlib

import numpy as np

from benchmarks.protocol import Problem
from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.landmarks import pose_from_landmarks

MISS = 0.004        # m, between a landmark and where it is touched
WITHIN = 0.12       # m of the middle of the points: what can be reached


def from_landmarks(problem: Problem) -> Array:
    """Return a T_bone_tracker from three landmarks, each touched 4 mm off; seeded by the trial."""
    surface = problem.field.surface_points.astype(np.float64)
    places = landmark_places(surface, problem.touched.mean(axis=0))
    rng = np.random.default_rng(zlib.crc32(f'landmarks {problem.trial.name}'.encode()))
    off = rng.normal(size=places.shape)
    off *= MISS / np.linalg.norm(off, axis=1, keepdims=True)
    touched = rigid.transform(problem.drag.T_tracker_bone, places) + off
    return rigid.inverse(pose_from_landmarks(places, touched)[0])


def from_centroids(problem: Problem, points: Array) -> Array:
    """Return the T_bone_tracker that lays the centroid of the points on the bone's, unturned."""
    away = problem.field.surface_points.mean(axis=0, dtype=np.float64) - points.mean(axis=0)
    return rigid.from_rt(np.eye(3), away)


def landmark_places(surface: Array, centre: Array) -> Array:
    """Return three surface points (3, 3) within reach, far from one another and from one line."""
    within = surface[np.linalg.norm(surface - centre, axis=1) < WITHIN]
    first = within[np.argmax(np.linalg.norm(within - centre, axis=1))]
    second = within[np.argmax(np.linalg.norm(within - first, axis=1))]
    third = within[np.argmax(np.linalg.norm(np.cross(within - first, second - first), axis=1))]
    return np.stack([first, second, third])
