# SPDX-License-Identifier: Apache-2.0
"""Hard cases: small parts of a bone, an inaccurate model, another object, only noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import Patch, exposed_patch, whole_surface
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, measure
from gsdf_registration.simulation.surface_errors import displaced, smooth_error

CUP = (0.020, 0.025)        # m, radius of the ball around the floor of the cup
SHAFT = 0.042               # m, radius of the ball around a point of the shaft
MIDDLE = (0.35, 0.65)       # range of the length of a long bone that is shaft only
OBJECT = (0.008, 0.030)     # m, half the width of an object along each axis
MODEL_ERROR = 0.0003        # m, standard deviation
CORRELATION = 0.015         # m, length over which the model error is correlated


def cup(vertices: Array, faces: np.ndarray, region: Patch, rng: np.random.Generator) -> Patch:
    """Return the floor of the cup inside ``region``: nearly a sphere."""
    middles = region.corners.mean(axis=1)
    arms = middles - region.centre
    aside = arms - (arms @ region.approach)[:, None] * region.approach
    floor = middles[np.argmin(np.linalg.norm(aside, axis=1))]
    return exposed_patch(vertices, faces, floor, rng.uniform(*CUP), region.approach)


def shaft(vertices: Array, faces: np.ndarray, rng: np.random.Generator) -> Patch:
    """Return a part of the shaft of a long bone: nearly a cylinder."""
    axis = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2][0]
    height = vertices @ axis
    share = (height - height.min()) / np.ptp(height)
    inside = np.flatnonzero((share > MIDDLE[0]) & (share < MIDDLE[1]))
    return exposed_patch(vertices, faces, vertices[rng.choice(inside)], SHAFT)


def moved(patch: Patch, T: Array) -> Patch:
    """Return a patch transformed by ``T`` (4, 4)."""
    R = T[:3, :3]
    return replace(patch, corners=transform(T, patch.corners), normals=patch.normals @ R.T,
                   approach=R @ patch.approach)


def with_model_error(recording: SimulatedRecording, field: Field,
                     rng: np.random.Generator) -> SimulatedRecording:
    """Return a recording of a bone that deviates smoothly from its model, along the normals."""
    deviation = smooth_error(recording.tips, MODEL_ERROR, CORRELATION, rng)
    return displaced(recording, deviation[:, None] * field.sample(recording.tips)[1])


def other_object(rng: np.random.Generator) -> Patch:
    """Return the surface of an ellipsoid, a rod or a block, of 16 to 60 mm."""
    solid = (trimesh.creation.icosphere(subdivisions=4),
             trimesh.creation.cylinder(radius=1.0, height=2.0, sections=64),
             trimesh.creation.box(extents=(2.0, 2.0, 2.0)))[int(rng.integers(3))]
    return whole_surface(np.asarray(solid.vertices) * rng.uniform(*OBJECT, 3),
                         np.asarray(solid.faces))


def only_noise(bounds: Array, count: int, tracker: Tracker, T_tracker_bone: Array,
               rng: np.random.Generator) -> SimulatedRecording:
    """Return ``count`` samples, uniform in the box ``bounds`` (2, 3), m, enlarged by 20 %."""
    middle, half = bounds.mean(axis=0), 0.6 * np.ptp(bounds, axis=0)
    tips = middle + rng.uniform(-1.0, 1.0, (count, 3)) * half
    return SimulatedRecording(
        np.arange(count) / tracker.rate, measure(transform(T_tracker_bone, tips), tracker, rng),
        tips, np.full(count, Kind.UNIFORM, dtype=np.uint8), np.zeros(count, dtype=np.int32),
        T_tracker_bone)
