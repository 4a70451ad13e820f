# SPDX-License-Identifier: Apache-2.0
"""
What a recording holds besides the bone.

Strays, soft tissue, lift-offs, other objects, a resting tip.
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
    """What a sample is, and where the tip truly was."""

    SURFACE = 0         # on the bone, in a stroke
    UNIFORM = 1         # anywhere in the model's box grown by 20 %
    SOFT_TISSUE = 2     # in a stroke, 1 to 6 mm off the bone, always outward, smoothly
    LIFT_OFF = 3        # on an arc through the air to the next stroke
    OTHER_OBJECT = 4    # in a stroke on something near by: a retractor, another bone
    RESTING = 5         # on the bone, at one place for long


@dataclass(frozen=True)
class Interference:
    """The share of all samples that each kind takes, 0 to 1; together below 1."""

    uniform: float = 0.0
    soft_tissue: float = 0.0
    lift_off: float = 0.0
    other_object: float = 0.0
    resting: float = 0.0

    def counts(self, points: int) -> dict[Kind, int]:
        """
        Return the samples of each kind beside ``points`` samples of the bone.

        Raises
        ------
        InputError
            If a share is negative or they leave nothing for the bone.

        """
        shares = {Kind[share.name.upper()]: getattr(self, share.name) for share in fields(self)}
        rest = 1.0 - sum(shares.values())
        if min(shares.values()) < 0.0 or rest < 1e-6:
            raise InputError(
                'the shares of interference must each lie in [0, 1) and together stay below 1')
        return {kind: round(share / rest * points) for kind, share in shares.items()}


NONE = Interference()


class Samples(NamedTuple):
    """Samples in order: tips (n, 3) m, kinds (n,), strokes (n,), ticks (n,) since the last one."""

    tips: Array
    kinds: NDArray[np.uint8]
    strokes: NDArray[np.int32]
    ticks: Array


@dataclass(eq=False)
class Run:
    """
    Consecutive samples: tips (n, 3) m, kinds (n,), ticks (n,) since the last, normals (n, 3).

    A tick is a period of the tracker.  ``linked``: belongs to the stroke before, follows at once.
    """

    tips: Array
    kinds: NDArray[np.uint8]
    ticks: Array
    normals: Array | None = None
    linked: bool = False


def disturbed(strokes: list[Run], patch: Patch, counts: dict[Kind, int], rng: np.random.Generator,
              pause: tuple[float, float], step: float) -> Samples:
    """
    Return the samples of all strokes with interference put in.

    Parameters
    ----------
    strokes : list of Run, on the bone; changed in place where soft tissue lifts the tip
    counts : samples of each kind
    pause : (float, float), ticks, shortest and longest between strokes
    step : float, m from sample to sample

    """
    _lift_on_tissue(strokes, counts[Kind.SOFT_TISSUE], rng)
    for run in [*_other_strokes(patch, counts[Kind.OTHER_OBJECT], step, rng),
                *_resting_strokes(patch, counts[Kind.RESTING], rng)]:
        strokes.insert(int(rng.integers(0, len(strokes) + 1)), run)
    runs = _with_arcs(strokes, patch.approach, counts[Kind.LIFT_OFF], step, rng)
    for run in runs:
        if not run.linked:
            run.ticks[0] += rng.uniform(*pause)
    runs[0].ticks[0] = 1.0
    number = np.cumsum([not run.linked for run in runs]) - 1
    samples = Samples(np.concatenate([run.tips for run in runs]),
                      np.concatenate([run.kinds for run in runs]),
                      np.repeat(number, [len(run.ticks) for run in runs]).astype(np.int32),
                      np.concatenate([run.ticks for run in runs]))
    return _with_strays(samples, patch.bounds, counts[Kind.UNIFORM], rng)


def _lift_on_tissue(strokes: list[Run], count: int, rng: np.random.Generator) -> None:
    """Put soft tissue on a few places of the bone: the ``count`` samples nearest ride over it."""
    if count == 0:
        return
    tips = np.concatenate([run.tips for run in strokes])
    pads = tips[rng.integers(0, len(tips), int(rng.integers(1, 4)))]
    wide = rng.uniform(0.6, 1.4, len(pads))
    away = (np.linalg.norm(tips[:, None] - pads, axis=2) / wide).min(axis=1)
    under = np.argsort(away, kind='stable')[:count]
    height = rng.uniform(0.002, 0.006)
    lifts = np.zeros(len(tips))
    edge = max(away[under].max(), 1e-9)
    lifts[under] = 0.001 + (height - 0.001) * np.cos(0.5 * np.pi * away[under] / edge)
    first = 0
    for run in strokes:
        lift = lifts[first:first + len(run.tips)]
        first += len(run.tips)
        assert run.normals is not None
        run.tips = run.tips + lift[:, None] * run.normals
        run.kinds[lift > 0.0] = Kind.SOFT_TISSUE


@lru_cache(maxsize=1)
def _ball() -> Patch:
    ball = trimesh.creation.icosphere(subdivisions=3)
    return whole_surface(np.asarray(ball.vertices), np.asarray(ball.faces))


def _other_strokes(patch: Patch, count: int, step: float, rng: np.random.Generator) -> list[Run]:
    """Return ``count`` samples in one or two strokes on an ellipsoid that stands in the wound."""
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
    return [_run(tips[strokes == k], Kind.OTHER_OBJECT) for k in range(2) if (strokes == k).any()]


def _resting_strokes(patch: Patch, count: int, rng: np.random.Generator) -> list[Run]:
    """Return ``count`` samples of a tip that stays put, at one or two places on the bone."""
    if count == 0:
        return []
    places, _ = patch.random_points(2, rng)
    split = np.bincount(rng.integers(0, 2, count) if count > 400 else np.zeros(count, dtype=int),
                        minlength=2)
    return [
        _run(np.repeat(place[None], n, axis=0), Kind.RESTING) for place, n in zip(places, split)
        if n
    ]


def _with_arcs(strokes: list[Run], approach: Array, count: int, step: float,
               rng: np.random.Generator) -> list[Run]:
    """Return the strokes with ``count`` samples in the air between them, or after the only one."""
    gaps = max(len(strokes) - 1, 1)
    # the hand moves some six times as fast through the air, so an arc of 0.1 m takes this many
    arcs = rng.permutation(gaps)[:max(round(count * 6.0 * step / 0.1), 1)]
    sizes = np.bincount(arcs[np.arange(count) % len(arcs)], minlength=gaps)
    out: list[Run] = []
    for k, stroke in enumerate(strokes):
        out.append(stroke)
        if k >= gaps or sizes[k] == 0:
            continue
        a = stroke.tips[-1]
        b = strokes[k + 1].tips[0] if k + 1 < len(strokes) else a + 0.02 * rng.normal(size=3)
        s = np.arange(1, sizes[k] + 1)[:, None] / (sizes[k] + 1.0)
        smooth = s * s * (3.0 - 2.0 * s)
        rise = 0.001 + rng.uniform(0.008, 0.04) * np.sin(np.pi * s)
        arc = _run(a + (b - a) * smooth + rise * approach, Kind.LIFT_OFF)
        arc.linked = True
        out.append(arc)
        if k + 1 < len(strokes):
            strokes[k + 1].linked = True    # the hand goes on, nobody told the recorder
    return out


def _run(tips: Array, kind: Kind) -> Run:
    return Run(tips, np.full(len(tips), kind, dtype=np.uint8), np.ones(len(tips)))


def _with_strays(samples: Samples, bounds: Array, count: int, rng: np.random.Generator) -> Samples:
    """Put ``count`` samples in at random moments, uniform in the model's box grown by 20 %."""
    middle, half = bounds.mean(axis=0), 0.6 * np.ptp(bounds, axis=0)
    strays = middle + rng.uniform(-1.0, 1.0, (count, 3)) * half
    when = np.sort(rng.integers(1, len(samples.tips) + 1, count))
    return Samples(np.insert(samples.tips, when, strays, axis=0),
                   np.insert(samples.kinds, when, np.uint8(Kind.UNIFORM)),
                   np.insert(samples.strokes, when, samples.strokes[when - 1]),
                   np.insert(samples.ticks, when, 1.0))
