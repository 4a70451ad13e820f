# SPDX-License-Identifier: Apache-2.0
"""Simulate the recording of a tracked probe that touches a bone, with ground truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gsdf_registration.common.rigid import (
    Array,
    from_rt,
    rotation_exp,
    rotation_from_quaternion,
    transform,
)
from gsdf_registration.simulation.correlated_noise import correlated_noise
from gsdf_registration.simulation.distortion import Distortion
from gsdf_registration.simulation.interference import (
    NONE,
    Interference,
    Kind,
    Samples,
    Segment,
    add_interference,
)
from gsdf_registration.simulation.losses import dropout_mask
from gsdf_registration.simulation.patch import Patch, walk


@dataclass(frozen=True)
class Tracker:
    """The properties of the tracker, in its frame."""

    rate: float = 80.0              # Hz
    sigma: float | tuple[float, float, float] = 0.00015     # m, standard deviation per axis
    jitter: float = 0.05            # standard deviation of a stamp, in periods
    dropouts: float = 0.0           # share of the samples of strokes that are lost, in bursts
    # m, RMS of a smooth, constant displacement, another one in each simulation; or a certain one
    distortion: float | Distortion = 0.0


@dataclass(frozen=True)
class Hand:
    """The motion of the probe."""

    speed: float = 0.027            # m/s, median
    unsteadiness: float = 0.5       # standard deviation of the logarithm of the speed
    curvature: float = 40.0         # 1/m, standard deviation of the curvature
    stroke: float = 0.045           # m, length of a stroke
    pause: tuple[float, float] = (0.6, 1.5)     # s, between strokes


# with the frames in the air: a median of about 27 mm/s and 99 % 127 mm/s, as in a recording
# of a hip by an electromagnetic tracker that was published
REAL_HAND = Hand(speed=0.029, unsteadiness=0.67, stroke=0.15, pause=(1.3, 2.6))


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """
    A simulated recording with n samples and its ground truth.

    stamps : (n,) float64, s, strictly rising from about 0
    positions : (n, 3) float64, m, measured, tracker frame
    tips : (n, 3) float64, m, true positions of the tip, bone frame
    kinds : (n,) uint8, of `Kind`
    strokes : (n,) int32
    T_tracker_bone : (4, 4) float64
    """

    stamps: Array
    positions: Array
    tips: Array
    kinds: NDArray[np.uint8]
    strokes: NDArray[np.int32]
    T_tracker_bone: Array = field(default_factory=lambda: np.eye(4))

    @property
    def on_bone(self) -> NDArray[np.bool_]:
        """Return a mask (n,) of the samples that are on the bone."""
        return (self.kinds == Kind.SURFACE) | (self.kinds == Kind.RESTING)

    def part(self, rows: NDArray[np.bool_]) -> SimulatedRecording:
        """Return the samples in a mask (n,)."""
        return SimulatedRecording(self.stamps[rows], self.positions[rows], self.tips[rows],
                                  self.kinds[rows], self.strokes[rows], self.T_tracker_bone)


def simulate_scan(patch: Patch,
         points: int,
         rng: np.random.Generator,
         *,
         tracker: Tracker = Tracker(),
         interference: Interference = NONE,
         hand: Hand = Hand(),
         T_tracker_bone: Array | None = None) -> SimulatedRecording:
    """
    Simulate a probe that is dragged over ``patch`` in curved strokes.

    Parameters
    ----------
    patch : Patch, bone frame
    points : int
        Exact number of samples of kind `Kind.SURFACE`; interference is added to them, each kind
        with its share of all samples.
    rng : numpy Generator; the same state yields the same recording
    tracker : Tracker
    interference : Interference
    hand : Hand
    T_tracker_bone : (4, 4) float; None: identity

    Returns
    -------
    SimulatedRecording

    Raises
    ------
    InputError
        If the sum of the shares of interference is not below 1.

    """
    counts = interference.counts(points)
    period = 1.0 / tracker.rate
    segments = _strokes(patch, points + counts[Kind.SOFT_TISSUE], rng, tracker, hand)
    samples = add_interference(segments, patch, counts, rng, step=hand.speed * period,
                               pause=(hand.pause[0] / period, hand.pause[1] / period))
    return _track(samples, tracker, T_tracker_bone, rng)


def simulate_landmarks(places: ArrayLike,
         rng: np.random.Generator,
         *,
         tracker: Tracker = Tracker(),
         seconds: float = 1.0,
         apart: float = 2.0,
         miss: tuple[float, float] = (0.002, 0.004),
         T_tracker_bone: Array | None = None) -> SimulatedRecording:
    """
    Simulate a probe that is held at landmarks one after another, with a small miss distance.

    Parameters
    ----------
    places : (k, 3) float, m, bone frame
    seconds : float, s, for which the tip is stationary at a landmark
    apart : float, s, between two landmarks
    miss : (float, float), m, smallest and largest distance from a landmark to the touched point

    Returns
    -------
    SimulatedRecording
        The stroke number is the index of the landmark; ``tips`` are the points that were touched.

    """
    places = np.asarray(places, dtype=np.float64)
    side = rng.normal(size=places.shape)
    side *= (rng.uniform(*miss, len(places)) / np.linalg.norm(side, axis=1))[:, None]
    each = max(round(seconds * tracker.rate), 1)
    strokes = np.repeat(np.arange(len(places), dtype=np.int32), each)
    ticks = 1.0 + np.diff(strokes, prepend=0) * apart * tracker.rate
    kinds = np.full(len(strokes), Kind.RESTING, dtype=np.uint8)
    return _track(Samples((places + side)[strokes], kinds, strokes, ticks), tracker,
                    T_tracker_bone, rng)


def measure(positions: Array, tracker: Tracker, rng: np.random.Generator) -> Array:
    """Return ``positions`` (n, 3), m, tracker frame, with distortion and noise of the tracker."""
    field = tracker.distortion
    if not isinstance(field, Distortion):
        field = Distortion.random(field, rng)
    noise = rng.normal(size=positions.shape) * np.broadcast_to(tracker.sigma, 3)
    return positions + field.displacement(positions) + noise


def measured_poses(T_tracker_body: Array, tracker: Tracker, orientation_noise: float,
                   rng: np.random.Generator) -> Array:
    """
    Return poses (n, 4, 4), m, of a body with distortion and noise of the tracker.

    Parameters
    ----------
    T_tracker_body : (n, 4, 4) float, m
    tracker : Tracker
    orientation_noise : float, rad per axis, standard deviation
    rng : numpy Generator

    """
    T = T_tracker_body.copy()
    positions = T[:, :3, 3]
    if isinstance(tracker.distortion, Distortion):
        T[:, :3, :3] = Rotation.from_rotvec(
            tracker.distortion.rotation(positions)).as_matrix() @ T[:, :3, :3]
    noise = Rotation.from_rotvec(orientation_noise * rng.normal(size=positions.shape))
    T[:, :3, :3] = T[:, :3, :3] @ noise.as_matrix()
    T[:, :3, 3] = measure(positions, tracker, rng)
    return T


def random_pose(rng: np.random.Generator,
                *,
                angle: float | None = None,
                translation: float = 1.0) -> Array:
    """
    Return a random rigid motion (4, 4).

    Parameters
    ----------
    angle : float, rad
        Largest rotation about x, then y, then z; None: uniform over all rotations.
    translation : float, m, largest translation along each axis

    """
    t = rng.uniform(-translation, translation, 3)
    if angle is None:
        return from_rt(rotation_from_quaternion(rng.normal(size=4)), t)
    x, y, z = (rotation_exp(a * e) for a, e in zip(rng.uniform(-angle, angle, 3), np.eye(3)))
    return from_rt(z @ y @ x, t)


def _track(samples: Samples, tracker: Tracker, T_tracker_bone: Array | None,
             rng: np.random.Generator) -> SimulatedRecording:
    """Return the recording of samples in the bone frame."""
    T = np.eye(4) if T_tracker_bone is None else np.asarray(T_tracker_bone, dtype=np.float64)
    jitter = np.clip(rng.normal(0.0, tracker.jitter, len(samples.ticks)), -0.4, 0.4)
    stamps = (np.cumsum(samples.ticks) + jitter) / tracker.rate
    positions = measure(transform(T, samples.tips), tracker, rng)
    return SimulatedRecording(stamps, positions, samples.tips, samples.kinds, samples.strokes, T)


def _strokes(patch: Patch, count: int, rng: np.random.Generator, tracker: Tracker,
             hand: Hand) -> list[Segment]:
    """Return ``count`` samples in strokes over the bone, without those lost in drop-outs."""
    lost = round(tracker.dropouts / (1.0 - tracker.dropouts) * count)
    n = count + lost
    step = hand.speed / tracker.rate
    strokes = _stroke_numbers(n, max(round(n * step / hand.stroke), 1), rng)
    starts, faces = _spread_starts(patch, strokes[-1] + 1, rng)
    steps = step * np.exp(hand.unsteadiness * correlated_noise(n, 0.2 * tracker.rate, rng))
    turns = hand.curvature * correlated_noise(n, 0.015 / step, rng) * steps
    headings = rng.uniform(0.0, 2.0 * np.pi, len(starts))
    tips, faces = walk(patch, starts, faces, headings, strokes, steps, turns)
    kept = dropout_mask(n, lost, max(round(0.1 * tracker.rate), 2), rng)
    ticks = np.diff(np.flatnonzero(kept), prepend=-1).astype(np.float64)
    tips, faces, strokes = tips[kept], faces[kept], strokes[kept]
    kinds = np.full(len(tips), Kind.SURFACE, dtype=np.uint8)
    return [Segment(tips[own], kinds[own], ticks[own], patch.normals[faces[own]])
            for own in (strokes == k for k in range(strokes[-1] + 1)) if own.any()]


def _stroke_numbers(n: int, strokes: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the stroke number of each of ``n`` samples, for strokes of similar length."""
    ends = np.cumsum(rng.uniform(0.6, 1.4, strokes))
    return np.searchsorted(ends / ends[-1] * n, np.arange(n), side='right')


def _spread_starts(patch: Patch, count: int, rng: np.random.Generator,
               tries: int = 6) -> tuple[Array, NDArray[np.int64]]:
    """Return distant starts, each the farthest of several from the others (Mitchell 1991)."""
    points, faces = patch.random_points(count * tries, rng)
    chosen = [0]
    for k in range(1, count):
        own = np.arange(k * tries, (k + 1) * tries)
        gaps = np.linalg.norm(points[own, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(own[np.argmax(gaps)]))
    return points[chosen], faces[chosen]
