# SPDX-License-Identifier: Apache-2.0
"""A probe dragged over a bone under a tracker: what is recorded, and what was true."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from gsdf_registration.common.rigid import (
    Array,
    from_rt,
    rotation_exp,
    rotation_from_quaternion,
    transform,
)
from gsdf_registration.simulation.interference import (
    NONE,
    Interference,
    Kind,
    Run,
    Samples,
    disturbed,
)
from gsdf_registration.simulation.patch import Patch, walk


@dataclass(frozen=True)
class Tracker:
    """How positions are measured; metres, hertz, axes of the tracker frame."""

    rate: float = 80.0
    sigma: float | tuple[float, float, float] = 0.00015     # standard deviation per axis
    jitter: float = 0.05            # standard deviation of a stamp, in periods
    dropouts: float = 0.0           # share of the strokes' samples lost, in runs
    distortion: float = 0.0         # root mean square of a smooth, fixed displacement


@dataclass(frozen=True)
class Hand:
    """How the probe is moved."""

    speed: float = 0.027            # m/s, median
    unsteadiness: float = 0.5       # standard deviation of the logarithm of the speed
    curvature: float = 40.0         # 1/m, standard deviation of the path's
    stroke: float = 0.045           # m, length of a stroke
    pause: tuple[float, float] = (0.6, 1.5)     # s, between strokes


@dataclass(frozen=True, eq=False)
class Drag:
    """
    A simulated recording of n samples and its truth.

    stamps : (n,) float64, s, strictly rising from about 0
    positions : (n, 3) float64, m, tracker frame, as measured
    tips : (n, 3) float64, m, bone frame, where the tip truly was
    kinds : (n,) uint8, a `Kind` each
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
        """Return which samples truly touch the bone (n,)."""
        return (self.kinds == Kind.SURFACE) | (self.kinds == Kind.RESTING)


def drag(patch: Patch,
         points: int,
         rng: np.random.Generator,
         *,
         tracker: Tracker = Tracker(),
         interference: Interference = NONE,
         hand: Hand = Hand(),
         T_tracker_bone: Array | None = None) -> Drag:
    """
    Drag a probe over ``patch`` in curved strokes.

    Parameters
    ----------
    patch : Patch, bone frame
    points : int
        Samples of kind `Kind.SURFACE`, exactly; interference comes on top, each kind with its share
        of all.
    rng : numpy Generator; the same state gives the same recording
    tracker, interference, hand : how it is measured, disturbed and moved
    T_tracker_bone : (4, 4) float; None: identity

    Returns
    -------
    Drag

    Raises
    ------
    InputError
        If the shares of interference leave nothing for the bone.

    """
    counts = interference.counts(points)
    period = 1.0 / tracker.rate
    runs = _strokes(patch, points + counts[Kind.SOFT_TISSUE], rng, tracker, hand)
    samples = disturbed(runs, patch, counts, rng, step=hand.speed * period,
                        pause=(hand.pause[0] / period, hand.pause[1] / period))
    return _tracked(samples, tracker, T_tracker_bone, rng)


def rest(places: ArrayLike,
         rng: np.random.Generator,
         *,
         tracker: Tracker = Tracker(),
         seconds: float = 1.0,
         apart: float = 2.0,
         miss: tuple[float, float] = (0.002, 0.004),
         T_tracker_bone: Array | None = None) -> Drag:
    """
    Touch landmarks one after another, missing each by a little, and rest there.

    Parameters
    ----------
    places : (k, 3) float, m, bone frame
    seconds, apart : float, s, for which the tip rests at a landmark, and between two of them
    miss : float, m, smallest and largest distance between the place and where it is touched

    Returns
    -------
    Drag
        The landmark's number is the stroke; ``tips`` are the places truly touched.

    """
    places = np.asarray(places, dtype=np.float64)
    side = rng.normal(size=places.shape)
    side *= (rng.uniform(*miss, len(places)) / np.linalg.norm(side, axis=1))[:, None]
    each = max(round(seconds * tracker.rate), 1)
    strokes = np.repeat(np.arange(len(places), dtype=np.int32), each)
    ticks = 1.0 + np.diff(strokes, prepend=0) * apart * tracker.rate
    kinds = np.full(len(strokes), Kind.RESTING, dtype=np.uint8)
    return _tracked(Samples((places + side)[strokes], kinds, strokes, ticks), tracker,
                    T_tracker_bone, rng)


def measured(positions: Array, tracker: Tracker, rng: np.random.Generator) -> Array:
    """Return true ``positions`` (n, 3), m, tracker frame, with its distortion and noise."""
    waves = rng.normal(0.0, 2.0 * np.pi / 0.4, (3, 3))      # 1/m: some 0.4 m long
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    bent = tracker.distortion * np.sqrt(2.0 / 3.0) * np.sin(positions @ waves.T + phases)
    return positions + bent + rng.normal(size=positions.shape) * np.broadcast_to(tracker.sigma, 3)


def random_pose(rng: np.random.Generator,
                *,
                angle: float | None = None,
                translation: float = 1.0) -> Array:
    """
    Return a random rigid motion (4, 4).

    Parameters
    ----------
    angle : float, rad
        The rotation is of up to this much about x, then y, then z; None: uniform over all
        rotations.
    translation : float, m, up to this much along each axis

    """
    t = rng.uniform(-translation, translation, 3)
    if angle is None:
        return from_rt(rotation_from_quaternion(rng.normal(size=4)), t)
    x, y, z = (rotation_exp(a * e) for a, e in zip(rng.uniform(-angle, angle, 3), np.eye(3)))
    return from_rt(z @ y @ x, t)


def _tracked(samples: Samples, tracker: Tracker, T_tracker_bone: Array | None,
             rng: np.random.Generator) -> Drag:
    """Return what the tracker makes of samples in the bone frame."""
    T = np.eye(4) if T_tracker_bone is None else np.asarray(T_tracker_bone, dtype=np.float64)
    jitter = np.clip(rng.normal(0.0, tracker.jitter, len(samples.ticks)), -0.4, 0.4)
    stamps = (np.cumsum(samples.ticks) + jitter) / tracker.rate
    positions = measured(transform(T, samples.tips), tracker, rng)
    return Drag(stamps, positions, samples.tips, samples.kinds, samples.strokes, T)


def _strokes(patch: Patch, count: int, rng: np.random.Generator, tracker: Tracker,
             hand: Hand) -> list[Run]:
    """Return ``count`` samples in strokes over the bone; what drop-outs cost is walked on top."""
    lost = round(tracker.dropouts / (1.0 - tracker.dropouts) * count)
    n = count + lost
    step = hand.speed / tracker.rate
    strokes = _stroke_numbers(n, max(round(n * step / hand.stroke), 1), rng)
    starts, faces = _scattered(patch, strokes[-1] + 1, rng)
    steps = step * np.exp(hand.unsteadiness * _wander(n, 0.2 * tracker.rate, rng))
    turns = hand.curvature * _wander(n, 0.015 / step, rng) * steps
    headings = rng.uniform(0.0, 2.0 * np.pi, len(starts))
    tips, faces = walk(patch, starts, faces, headings, strokes, steps, turns)
    kept = _kept(n, lost, max(round(0.1 * tracker.rate), 2), rng)
    ticks = np.diff(np.flatnonzero(kept), prepend=-1).astype(np.float64)
    tips, faces, strokes = tips[kept], faces[kept], strokes[kept]
    kinds = np.full(len(tips), Kind.SURFACE, dtype=np.uint8)
    return [Run(tips[own], kinds[own], ticks[own], patch.normals[faces[own]])
            for own in (strokes == k for k in range(strokes[-1] + 1)) if own.any()]


def _stroke_numbers(n: int, strokes: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return for each of ``n`` samples its stroke, the strokes of about one length."""
    ends = np.cumsum(rng.uniform(0.6, 1.4, strokes))
    return np.searchsorted(ends / ends[-1] * n, np.arange(n), side='right')


def _scattered(patch: Patch, count: int, rng: np.random.Generator,
               tries: int = 6) -> tuple[Array, NDArray[np.int64]]:
    """Return starts well apart, each the farthest of a few from those before (Mitchell 1991)."""
    points, faces = patch.random_points(count * tries, rng)
    chosen = [0]
    for k in range(1, count):
        own = np.arange(k * tries, (k + 1) * tries)
        gaps = np.linalg.norm(points[own, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(own[np.argmax(gaps)]))
    return points[chosen], faces[chosen]


def _wander(n: int, memory: float, rng: np.random.Generator) -> Array:
    """Return a stationary random series (n,), variance 1, that forgets over ``memory`` samples."""
    keep = np.exp(-1.0 / memory)
    noise = rng.normal(size=n) * np.sqrt(1.0 - keep * keep)
    noise[:1] /= np.sqrt(1.0 - keep * keep)
    return np.asarray(lfilter([1.0], [1.0, -keep], noise))


def _kept(n: int, lost: int, longest: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return a mask (n,) that misses exactly ``lost`` samples, in runs of up to ``longest``."""
    kept = np.ones(n, dtype=bool)
    while (left := lost - int(n - kept.sum())) > 0:
        first = int(rng.integers(0, n))
        kept[first:first + min(left, int(rng.integers(1, longest + 1)))] = False
    return kept
