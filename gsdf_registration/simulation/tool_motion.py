# SPDX-License-Identifier: Apache-2.0
"""
Carry a simulated probe along its recorded tips: the pose of the tool in every frame of the tracker.

A recording of positions has the samples on the bone. A tracker reports a tool all the time, so the
pauses between the strokes are filled with the way of the tip through the air.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.air import Distance, shaft_direction, way_between
from gsdf_registration.simulation.correlated_noise import unevenly_correlated_noise
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.pivoting import TIP
from gsdf_registration.simulation.probe import SimulatedRecording

WOBBLE = np.radians(2.0)    # standard deviation of the tilt of the shaft about each axis
SPIN = np.radians(20.0)     # of the rotation of the tool about its shaft
MEMORY = 1.5                # s, correlation time of both


@dataclass(frozen=True)
class Tool:
    """
    A tracked probe.

    tip : (x, y, z) m, in the frame of the tool: the centre of the ball
    shaft : (x, y, z), unit length, from the tip to the handle, in the frame of the tool
    """

    tip: tuple[float, float, float] = TIP
    shaft: tuple[float, float, float] = (0.0, 0.0, -1.0)


@dataclass(frozen=True, eq=False)
class ToolMotion:
    """
    The true motion of a tool over a bone, n samples.

    stamps : (n,) float64, s, strictly rising
    T_bone_tool : (n, 4, 4) float64, m
    tips, shafts : (n, 3) float64, m and unit length, bone frame
    kinds : (n,) uint8, of `Kind`; `Kind.LIFT_OFF` in the air
    strokes : (n,) int32; samples in the air have the number of the stroke before
    """

    stamps: Array
    T_bone_tool: Array
    tips: Array
    shafts: Array
    kinds: NDArray[np.uint8]
    strokes: NDArray[np.int32]


def carried(recording: SimulatedRecording, patch: Patch, distance: Distance, rate: float,
            rng: np.random.Generator, tool: Tool = Tool()) -> ToolMotion:
    """
    Return the motion of a tool whose tip makes a recording.

    Parameters
    ----------
    recording : SimulatedRecording
        Its true tips and stamps are used, not its measured positions.
    patch : Patch, bone frame
    distance : Distance
        To the bone that is touched; neither tip nor shaft enters it between the strokes.
    rate : float, Hz, of the tracker
    rng : numpy Generator
    tool : Tool

    """
    numbers = np.unique(recording.strokes)
    rows = [np.flatnonzero(recording.strokes == number) for number in numbers]
    directions = [shaft_direction(recording.tips[own], patch, distance, rng) for own in rows]
    parts = []
    for k, own in enumerate(rows):
        parts.append((recording.stamps[own], recording.tips[own],
                      np.tile(directions[k], (len(own), 1)), recording.kinds[own], numbers[k]))
        if k + 1 < len(rows):
            last, first = own[-1], rows[k + 1][0]
            stamps = _frames_between(recording.stamps[last], recording.stamps[first], rate)
            tips, shafts = way_between(
                (recording.tips[last], recording.tips[first]), (directions[k], directions[k + 1]),
                patch, distance, rng, partial(_least_jerk, len(stamps)))
            tips, shafts = tips[1:-1], shafts[1:-1]     # without the ends, which are on the bone
            stamps = stamps[:len(tips)]                 # none if there is no free way
            parts.append((stamps, tips, shafts,
                          np.full(len(tips), Kind.LIFT_OFF, dtype=np.uint8), numbers[k]))
    stamps, tips, shafts, kinds = (np.concatenate([part[i] for part in parts]) for i in range(4))
    strokes = np.repeat(np.array([part[4] for part in parts], dtype=np.int32),
                        [len(part[0]) for part in parts])
    turns = _orientations(shafts, stamps, patch.approach, tool, rng)
    T = np.tile(np.eye(4), (len(tips), 1, 1))
    T[:, :3, :3] = turns.as_matrix()
    T[:, :3, 3] = tips - turns.apply(tool.tip)
    return ToolMotion(stamps, T, tips, turns.apply(tool.shaft), kinds, strokes)


def _frames_between(last: float, first: float, rate: float) -> Array:
    """Return the times of the frames of the tracker in a pause, s."""
    count = max(round((first - last) * rate) - 1, 0)
    return np.asarray(last + (first - last) * np.arange(1, count + 1) / (count + 1))


def _least_jerk(count: int, length: float) -> Array:
    """Return where ``count`` samples and both ends are on a way (Flash and Hogan 1985)."""
    s = np.linspace(0.0, 1.0, count + 2)
    return np.asarray(length * s**3 * (10.0 - 15.0 * s + 6.0 * s * s))


def _orientations(shafts: Array, stamps: Array, approach: Array, tool: Tool,
                  rng: np.random.Generator) -> Rotation:
    """Return the orientations of a tool whose shaft is along ``shafts`` (n, 3), bone frame."""
    wobble = Rotation.from_rotvec(WOBBLE * unevenly_correlated_noise(stamps, 3, MEMORY, rng))
    held = Rotation.align_vectors(approach[None], np.array(tool.shaft)[None])[0]
    tilted = wobble * Rotation.from_rotvec(_shortest_arc(approach, shafts)) * held
    spin = rng.uniform(0.0, 2.0 * np.pi) + SPIN * unevenly_correlated_noise(stamps, 1, MEMORY, rng)
    return tilted * Rotation.from_rotvec(spin * np.array(tool.shaft))


def _shortest_arc(start: Array, ends: Array) -> Array:
    """Return the rotation vectors (n, 3) that turn ``start`` (3,) to ``ends`` (n, 3)."""
    axes = np.cross(start, ends)
    sines = np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.arctan2(sines, (ends @ start)[:, None])
    return np.asarray(axes * angles / np.maximum(sines, 1e-12))
