# SPDX-License-Identifier: Apache-2.0
"""
Add interference to a simulated recording.

Interference is every sample that is not on the bone in a stroke: scattered outliers, soft tissue,
lift-offs, other objects and a stationary tip.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, rotation_from_quaternion
from gsdf_registration.simulation.patch import Patch, walk, whole_surface


class Kind(IntEnum):
    """The kind of a sample, which tells where the tip was."""

    SURFACE = 0         # on the bone, in a stroke
    UNIFORM = 1         # uniform in the bounding box of the model enlarged by 20 %
    SOFT_TISSUE = 2     # in a stroke, 1 to 6 mm outside the bone, varying smoothly
    LIFT_OFF = 3        # on an arc to the next stroke
    OTHER_OBJECT = 4    # in a stroke on an object near the bone, such as a retractor
    RESTING = 5         # on the bone, stationary


@dataclass(frozen=True)
class Interference:
    """The share of each kind in all samples, in [0, 1); their sum must be below 1."""

    uniform: float = 0.0
    soft_tissue: float = 0.0
    lift_off: float = 0.0
    other_object: float = 0.0
    resting: float = 0.0

    def counts(self, points: int) -> dict[Kind, int]:
        """
        Return the number of samples of each kind to add to ``points`` samples of the bone.

        Raises
        ------
        InputError
            If a share is negative or the sum is not below 1.

        """
        shares = {Kind[share.name.upper()]: getattr(self, share.name) for share in fields(self)}
        rest = 1.0 - sum(shares.values())
        if min(shares.values()) < 0.0 or rest < 1e-6:
            raise InputError(
                'the shares of interference must be in [0, 1) and their sum must be below 1')
        return {kind: round(share / rest * points) for kind, share in shares.items()}


NONE = Interference()


class Samples(NamedTuple):
    """Samples in order: tips (n, 3) m, kinds, strokes, and ticks since the previous sample (n,)."""

    tips: Array
    kinds: NDArray[np.uint8]
    strokes: NDArray[np.int32]
    ticks: Array


@dataclass(eq=False)
class Segment:
    """
    Consecutive samples.

    tips : (n, 3) float64, m, bone frame
    kinds : (n,) uint8, of `Kind`
    ticks : (n,) float64, periods of the tracker since the previous sample
    normals : (n, 3) float64, of the surface; None if the samples are not on the bone
    linked : whether it belongs to the stroke of the previous segment and follows without a pause
    """

    tips: Array
    kinds: NDArray[np.uint8]
    ticks: Array
    normals: Array | None = None
    linked: bool = False


def add_interference(strokes: list[Segment], patch: Patch, counts: dict[Kind, int],
                     rng: np.random.Generator, pause: tuple[float, float], step: float) -> Samples:
    """
    Return the samples of all strokes with interference.

    Parameters
    ----------
    strokes : list of Segment, on the bone; modified in place by soft tissue
    counts : number of samples of each kind
    pause : (float, float), ticks, shortest and longest pause between strokes
    step : float, m, distance between samples

    """
    _add_soft_tissue(strokes, counts[Kind.SOFT_TISSUE], rng)
    for segment in [*_other_strokes(patch, counts[Kind.OTHER_OBJECT], step, rng),
                    *_stationary_segments(patch, counts[Kind.RESTING], rng)]:
        strokes.insert(int(rng.integers(0, len(strokes) + 1)), segment)
    segments = _with_arcs(strokes, patch.approach, counts[Kind.LIFT_OFF], step, rng)
    for segment in segments:
        if not segment.linked:
            segment.ticks[0] += rng.uniform(*pause)
    segments[0].ticks[0] = 1.0
    numbers = np.cumsum([not segment.linked for segment in segments]) - 1
    samples = Samples(np.concatenate([segment.tips for segment in segments]),
                      np.concatenate([segment.kinds for segment in segments]),
                      np.repeat(numbers, [len(each.ticks) for each in segments]).astype(np.int32),
                      np.concatenate([segment.ticks for segment in segments]))
    return _insert_outliers(samples, patch.bounds, counts[Kind.UNIFORM], rng)


def _add_soft_tissue(strokes: list[Segment], count: int, rng: np.random.Generator) -> None:
    """Lift the ``count`` samples nearest to one to three places, as soft tissue there would."""
    if count == 0:
        return
    tips = np.concatenate([segment.tips for segment in strokes])
    places = tips[rng.integers(0, len(tips), int(rng.integers(1, 4)))]
    width = rng.uniform(0.6, 1.4, len(places))
    away = (np.linalg.norm(tips[:, None] - places, axis=2) / width).min(axis=1)
    under = np.argsort(away, kind='stable')[:count]
    height = rng.uniform(0.002, 0.006)
    lifts = np.zeros(len(tips))
    edge = max(away[under].max(), 1e-9)
    lifts[under] = 0.001 + (height - 0.001) * np.cos(0.5 * np.pi * away[under] / edge)
    first = 0
    for segment in strokes:
        lift = lifts[first:first + len(segment.tips)]
        first += len(segment.tips)
        assert segment.normals is not None
        segment.tips = segment.tips + lift[:, None] * segment.normals
        segment.kinds[lift > 0.0] = Kind.SOFT_TISSUE


@lru_cache(maxsize=1)
def _ball() -> Patch:
    """Return the unit sphere."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    return whole_surface(np.asarray(ball.vertices), np.asarray(ball.faces))


def _other_strokes(patch: Patch, count: int, step: float,
                   rng: np.random.Generator) -> list[Segment]:
    """Return ``count`` samples in one or two strokes on an ellipsoid in the exposed area."""
    if count == 0:
        return []
    radii = rng.uniform(0.008, 0.03, 3)
    place, _ = patch.random_points(1, rng)
    centre = place[0] + patch.approach * (radii.max() + rng.uniform(0.002, 0.015))
    ball = _ball()
    strokes = np.sort(rng.integers(0, 2, count))
    starts, faces = ball.random_points(2, rng)
    steps = step / radii.mean() * rng.uniform(0.5, 1.5, count)
    points, _ = walk(ball, starts, faces, rng.uniform(0.0, 2.0 * np.pi, 2), strokes, steps,
                     rng.normal(0.0, 0.1) * steps)
    tips = centre + (points * radii) @ rotation_from_quaternion(rng.normal(size=4)).T
    return [_segment(tips[strokes == k], Kind.OTHER_OBJECT) for k in range(2)
            if (strokes == k).any()]


def _stationary_segments(patch: Patch, count: int, rng: np.random.Generator) -> list[Segment]:
    """Return ``count`` samples of a stationary tip, at one or two places on the bone."""
    if count == 0:
        return []
    places, _ = patch.random_points(2, rng)
    split = np.bincount(rng.integers(0, 2, count) if count > 400 else np.zeros(count, dtype=int),
                        minlength=2)
    return [_segment(np.repeat(place[None], n, axis=0), Kind.RESTING)
            for place, n in zip(places, split) if n]


def _with_arcs(strokes: list[Segment], approach: Array, count: int, step: float,
               rng: np.random.Generator) -> list[Segment]:
    """Return the strokes with ``count`` samples on arcs between them, or after the only one."""
    gaps = max(len(strokes) - 1, 1)
    # the hand is about six times faster in the air; the number of arcs of 0.1 m follows from that
    arcs = rng.permutation(gaps)[:max(round(count * 6.0 * step / 0.1), 1)]
    sizes = np.bincount(arcs[np.arange(count) % len(arcs)], minlength=gaps)
    out: list[Segment] = []
    for k, stroke in enumerate(strokes):
        out.append(stroke)
        if k >= gaps or sizes[k] == 0:
            continue
        a = stroke.tips[-1]
        b = strokes[k + 1].tips[0] if k + 1 < len(strokes) else a + 0.02 * rng.normal(size=3)
        s = np.arange(1, sizes[k] + 1)[:, None] / (sizes[k] + 1.0)
        smooth = s * s * (3.0 - 2.0 * s)
        rise = 0.001 + rng.uniform(0.008, 0.04) * np.sin(np.pi * s)
        arc = _segment(a + (b - a) * smooth + rise * approach, Kind.LIFT_OFF)
        arc.linked = True
        out.append(arc)
        if k + 1 < len(strokes):
            strokes[k + 1].linked = True    # the recording continues without a new stroke
    return out


def _segment(tips: Array, kind: Kind) -> Segment:
    """Return a segment of samples of one kind, one tick apart."""
    return Segment(tips, np.full(len(tips), kind, dtype=np.uint8), np.ones(len(tips)))


def _insert_outliers(samples: Samples, bounds: Array, count: int,
                     rng: np.random.Generator) -> Samples:
    """Insert ``count`` outliers at random times, uniform in the box enlarged by 20 %."""
    centre, half = bounds.mean(axis=0), 0.6 * np.ptp(bounds, axis=0)
    outliers = centre + rng.uniform(-1.0, 1.0, (count, 3)) * half
    when = np.sort(rng.integers(1, len(samples.tips) + 1, count))
    return Samples(np.insert(samples.tips, when, outliers, axis=0),
                   np.insert(samples.kinds, when, np.uint8(Kind.UNIFORM)),
                   np.insert(samples.strokes, when, samples.strokes[when - 1]),
                   np.insert(samples.ticks, when, 1.0))
