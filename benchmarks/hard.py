# SPDX-License-Identifier: Apache-2.0
"""Data from which no pose, or hardly one, can be had: little of a bone, none, or not the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import Patch, exposed_patch, whole_surface
from gsdf_registration.simulation.probe import Drag, Tracker, measured

CUP = (0.020, 0.025)        # m, radius of the ball round the floor of a cup
SHAFT = 0.042               # m, radius of the ball round a place on a shaft
MIDDLE = (0.35, 0.65)       # share of a long bone's length that is nothing but shaft
OBJECT = (0.008, 0.030)     # m, half the width of an object along each axis
OFF, ALIKE = 0.0003, 0.015  # m: how far a bone is off its model (SD), over how much of it alike
WAVES = 200                 # that this is made of


def cup(vertices: Array, faces: np.ndarray, region: Patch, rng: np.random.Generator) -> Patch:
    """Return the floor of the cup that ``region`` surrounds: nearly a sphere."""
    middles = region.corners.mean(axis=1)
    arms = middles - region.centre
    aside = arms - (arms @ region.approach)[:, None] * region.approach
    floor = middles[np.argmin(np.linalg.norm(aside, axis=1))]
    return exposed_patch(vertices, faces, floor, rng.uniform(*CUP), region.approach)


def shaft(vertices: Array, faces: np.ndarray, rng: np.random.Generator) -> Patch:
    """Return a place on the shaft of a long bone: nearly a cylinder."""
    axis = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2][0]
    height = vertices @ axis
    share = (height - height.min()) / np.ptp(height)
    inside = np.flatnonzero((share > MIDDLE[0]) & (share < MIDDLE[1]))
    return exposed_patch(vertices, faces, vertices[rng.choice(inside)], SHAFT)


def moved(patch: Patch, T: Array) -> Patch:
    """Return a patch moved by a rigid motion ``T`` (4, 4)."""
    R = T[:3, :3]
    return replace(patch, corners=transform(T, patch.corners), normals=patch.normals @ R.T,
                   approach=R @ patch.approach)


def off_the_model(run: Drag, field: Field, rng: np.random.Generator) -> Drag:
    """
    Return a recording as if the bone were not quite its model: smoothly, in and out.

    Random Fourier features of a Gaussian process (Rahimi and Recht 2007) along the normals.
    """
    waves, phases = rng.normal(0.0, 1.0 / ALIKE, (WAVES, 3)), rng.uniform(0.0, 2.0 * np.pi, WAVES)
    off = OFF * np.sqrt(2.0 / WAVES) * np.cos(run.tips @ waves.T + phases).sum(axis=1)
    shift = off[:, None] * field.sample(run.tips)[1]
    return replace(run, tips=run.tips + shift,
                   positions=run.positions + shift @ run.T_tracker_bone[:3, :3].T)


def other_object(rng: np.random.Generator) -> Patch:
    """Return the whole of something smooth: an egg, a rod or a block, of 16 to 60 mm."""
    solid = (trimesh.creation.icosphere(subdivisions=4),
             trimesh.creation.cylinder(radius=1.0, height=2.0, sections=64),
             trimesh.creation.box(extents=(2.0, 2.0, 2.0)))[int(rng.integers(3))]
    return whole_surface(np.asarray(solid.vertices) * rng.uniform(*OBJECT, 3),
                         np.asarray(solid.faces))


def scattered(bounds: Array, count: int, tracker: Tracker, T_tracker_bone: Array,
              rng: np.random.Generator) -> Drag:
    """Return ``count`` samples of nothing, uniform in the box ``bounds`` (2, 3) grown by 20 %."""
    middle, half = bounds.mean(axis=0), 0.6 * np.ptp(bounds, axis=0)
    tips = middle + rng.uniform(-1.0, 1.0, (count, 3)) * half
    return Drag(np.arange(count) / tracker.rate,
                measured(transform(T_tracker_bone, tips), tracker, rng), tips,
                np.full(count, Kind.UNIFORM, dtype=np.uint8), np.zeros(count, dtype=np.int32),
                T_tracker_bone)
