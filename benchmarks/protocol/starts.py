# SPDX-License-Identifier: Apache-2.0
"""Initial guesses for the methods that need one."""

from __future__ import annotations

import zlib

import numpy as np

from benchmarks.protocol.trials import Problem
from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.landmarks import pose_from_landmarks

# m, between a landmark and the touched point: for methods that need a start, and where landmarks
# belong to the scenario
LANDMARK_ERROR, GIVEN_ERROR = 0.004, 0.003
REACH = 0.12            # m, from the centroid of the points to a landmark


def from_landmarks(problem: Problem) -> Array:
    """Return T_bone_tracker from three landmarks."""
    return rigid.inverse(pose_from_landmarks(*touched_landmarks(problem))[0])


def given_landmarks(problem: Problem) -> tuple[Array, Array] | None:
    """Return the `touched_landmarks` if they belong to the scenario, else None."""
    return touched_landmarks(problem) if problem.trial.scenario.landmarks else None


def touched_landmarks(problem: Problem) -> tuple[Array, Array]:
    """Return three landmarks (3, 3) in the bone frame, and touched, m, seeded by the trial."""
    surface = problem.field.surface_points.astype(np.float64)
    places = landmark_places(surface, problem.touched.mean(axis=0))
    rng = np.random.default_rng(zlib.crc32(f'landmarks {problem.trial.name}'.encode()))
    error = rng.normal(size=places.shape)
    size = GIVEN_ERROR if problem.trial.scenario.landmarks else LANDMARK_ERROR
    error *= size / np.linalg.norm(error, axis=1, keepdims=True)
    return places, rigid.transform(problem.recording.T_tracker_bone, places) + error


def from_centroids(problem: Problem, points: Array) -> Array:
    """Return the T_bone_tracker without rotation that moves the centroid of the points."""
    shift = problem.field.surface_points.mean(axis=0, dtype=np.float64) - points.mean(axis=0)
    return rigid.from_rt(np.eye(3), shift)


def landmark_places(surface: Array, centroid: Array) -> Array:
    """Return three surface points (3, 3) within reach, far apart and not on a line."""
    within = surface[np.linalg.norm(surface - centroid, axis=1) < REACH]
    first = within[np.argmax(np.linalg.norm(within - centroid, axis=1))]
    second = within[np.argmax(np.linalg.norm(within - first, axis=1))]
    third = within[np.argmax(np.linalg.norm(np.cross(within - first, second - first), axis=1))]
    return np.stack([first, second, third])
