# SPDX-License-Identifier: Apache-2.0
"""Simulate tool poses of a pivot calibration and of a leg swing, with noise, slips and gaps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.correlated_noise import correlated_noise

TIP = (0.012, -0.021, 0.148)            # m, tool frame
PIVOT_PLACE = (0.10, -0.20, -1.20)      # m, tracker frame
HIP_CENTRE = (0.03, 0.05, 0.38)         # m, frame of an array on the distal femur
HIP_PLACE = (-0.15, 0.10, -1.40)        # m, tracker frame


class PoseKind(IntEnum):
    """The kind of a pose, known from the simulation."""

    IN_PLACE = 0
    SLIPPED = 1     # the point has moved to another place
    WRONG = 2       # a wrong reading


@dataclass(frozen=True)
class Turning:
    """
    The rotation of the body about the fixed point: on a cone whose opening angle varies.

    tilt, spin : rad, largest angle from the mean, and largest rotation about the z axis of the body
    circle, opening, roll : s, periods of the three motions
    """

    tilt: float = np.radians(25.0)
    spin: float = np.radians(15.0)
    circle: float = 2.3
    opening: float = 13.0
    roll: float = 5.1


LEG = Turning(np.radians(20.0), np.radians(10.0), 3.1, 17.0, 7.3)


@dataclass(frozen=True)
class PoseNoise:
    """
    The noise of the tracker, and the slow motion of the fixed point.

    position : m per axis, independent
    orientation : rad per axis, independent
    wander, memory : m per axis and s, standard deviation and correlation time of the slow motion
        of the fixed point about its place
    """

    position: float = 0.0002
    orientation: float = np.radians(0.1)
    wander: float = 0.0
    memory: float = 0.5


@dataclass(frozen=True)
class PoseFaults:
    """
    Faults in a recording.

    slips : (time s, displacement m) each; the displacement is in a random direction
    dropouts : share of the poses that are missing, in gaps of up to 0.3 s
    wrong : share of the poses that are wrong readings, by several cm and tens of degrees
    """

    slips: tuple[tuple[float, float], ...] = ()
    dropouts: float = 0.0
    wrong: float = 0.0


@dataclass(frozen=True)
class PivotRecording:
    """
    A simulated recording with its ground truth.

    stamps : (n,) float64, s
    T_tracker_body : (n, 4, 4) float64, m, as measured
    kinds : (n,) uint8, a `PoseKind` each
    point, centre : (3,) m, the fixed point in the body frame, and its place in the tracker
        frame before any slip
    centres : (n, 3) m, its place at each pose, tracker frame
    """

    stamps: Array
    T_tracker_body: Array
    kinds: NDArray[np.uint8]
    point: Array
    centre: Array
    centres: Array


def pivoting(rng: np.random.Generator, seconds: float = 20.0, rate: float = 40.0, *,
             turning: Turning = Turning(), noise: PoseNoise = PoseNoise(),
             faults: PoseFaults = PoseFaults(), tip: ArrayLike = TIP,
             pivot: ArrayLike = PIVOT_PLACE, mean: ArrayLike | None = None) -> PivotRecording:
    """
    Simulate a tool that is turned with its tip in a divot.

    Parameters
    ----------
    rng : numpy Generator; the same state gives the same recording
    seconds, rate : float, s and Hz
    turning : Turning
    noise : PoseNoise
    faults : PoseFaults
    tip : (3,) m, tool frame
    pivot : (3,) m, tracker frame
    mean : (3, 3), mean orientation of the body in the tracker frame; None: random

    Returns
    -------
    PivotRecording

    """
    n = max(round(seconds * rate), 1)
    stamps = np.arange(n) / rate
    point, centre = np.array(tip, dtype=np.float64), np.array(pivot, dtype=np.float64)
    middle = Rotation.random(random_state=np.random.RandomState(rng.integers(2**31)))
    if mean is not None:
        middle = Rotation.from_matrix(mean)
    turns = middle * _turns(stamps, turning, rng)
    kinds = np.full(n, PoseKind.IN_PLACE, dtype=np.uint8)
    centres = np.tile(centre, (n, 1))
    for time, displacement in faults.slips:
        centres[stamps >= time] += displacement * _direction(rng)
        kinds[stamps >= time] = PoseKind.SLIPPED
    moved = centres + noise.wander * correlated_noise((n, 3), max(noise.memory * rate, 1e-3), rng)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 3] = moved - turns.apply(point) + noise.position * rng.normal(size=(n, 3))
    measured = turns * Rotation.from_rotvec(noise.orientation * rng.normal(size=(n, 3)))
    wrong = rng.random(n) < faults.wrong
    errors = Rotation.from_rotvec(0.5 * rng.normal(size=(n, 3)))
    T[:, :3, :3] = np.where(wrong[:, None, None], (measured * errors).as_matrix(),
                            measured.as_matrix())
    T[:, :3, 3] += np.where(wrong[:, None], 0.05 * rng.normal(size=(n, 3)), 0.0)
    kinds[wrong] = PoseKind.WRONG
    kept = _received(n, faults.dropouts, rate, rng)
    return PivotRecording(stamps[kept], T[kept], kinds[kept], point, centre, centres[kept])


def leg_swing(rng: np.random.Generator, seconds: float = 30.0, rate: float = 30.0, *,
              turning: Turning = LEG,
              noise: PoseNoise = PoseNoise(wander=0.0015), faults: PoseFaults = PoseFaults(),
              hip_centre: ArrayLike = HIP_CENTRE, place: ArrayLike = HIP_PLACE,
              mean: ArrayLike | None = None) -> PivotRecording:
    """
    Simulate a leg that swings about its hip, whose centre moves slowly by 1.5 mm per axis (SD).

    Parameters are those of `pivoting`; ``hip_centre`` is in the frame of the reference array on the
    femur, ``place`` in the tracker frame.
    """
    return pivoting(rng, seconds, rate, turning=turning, noise=noise, faults=faults, tip=hip_centre,
                    pivot=place, mean=mean)


def _turns(stamps: Array, turning: Turning, rng: np.random.Generator) -> Rotation:
    """Return the rotations relative to the mean orientation."""
    circle, opening, roll = rng.uniform(0.0, 2.0 * np.pi, 3)
    tilt = turning.tilt * np.cos(2.0 * np.pi * stamps / turning.opening + opening)
    phase = 2.0 * np.pi * stamps / turning.circle + circle
    spin = turning.spin * np.sin(2.0 * np.pi * stamps / turning.roll + roll)
    zero = np.zeros_like(stamps)
    tilts = Rotation.from_rotvec(np.stack([tilt * np.cos(phase), tilt * np.sin(phase), zero], 1))
    return tilts * Rotation.from_rotvec(np.stack([zero, zero, spin], 1))


def _direction(rng: np.random.Generator) -> Array:
    direction = rng.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))


def _received(n: int, dropouts: float, rate: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return a mask (n,) of the poses that were received."""
    kept = np.ones(n, dtype=bool)
    longest = max(round(0.3 * rate), 1)
    while kept.mean() > 1.0 - dropouts:
        first = int(rng.integers(0, n))
        kept[first:first + int(rng.integers(1, longest + 1))] = False
    return kept
