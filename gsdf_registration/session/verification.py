# SPDX-License-Identifier: Apache-2.0
"""
Places touched on the bone after registration, never used in the fit: do they lie on its surface.

One that is touched again is a checkpoint: it must be where it was in the frame of the points, or
the array that carries this frame was bumped, which no other number shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gsdf_registration.common.formatting import counted
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.session.stationary_tip import StationaryTip

SAME_PLACE = 0.005      # m; touched nearer to an earlier place than this, that one is meant


@dataclass(frozen=True)
class Verification:
    """A point touched on the bone after registration."""

    position: Array         # (3,) m, frame of the points
    distance_m: float       # signed, to the surface as last registered; negative: inside
    stamp: float            # s
    checkpoint: int         # number of the place, from 1
    moved_m: float | None   # since that place was first touched; None: touched for the first time


@dataclass(frozen=True)
class VerificationSummary:
    """All verification points at a glance; metres."""

    points: int
    worst_m: float          # largest distance to the surface, without its sign
    rms_m: float
    moved_m: float | None   # largest move of a checkpoint at its last touch; None: none is touched
    limit_m: float

    @property
    def good(self) -> bool:
        """Whether all are within the limit."""
        return max(self.worst_m, self.moved_m or 0.0) <= self.limit_m

    @property
    def sentence(self) -> str:
        """Return the summary in plain words."""
        words = (f'{counted(self.points, "verification point")}: worst '
                 f'{1e3 * self.worst_m:.1f} mm, {1e3 * self.rms_m:.1f} mm RMS')
        if self.moved_m is not None:
            words += f', checkpoints moved by up to {1e3 * self.moved_m:.1f} mm'
        return words + f', {"within" if self.good else "beyond"} {1e3 * self.limit_m:.1f} mm'


def distance_to(field: Field, T_bone_tracker: Array, position: Array) -> float:
    """Return the signed distance of ``position`` (3,), m, to the bone as registered, m."""
    return float(field.sample(transform(T_bone_tracker, position)[None])[0][0])


def verified(rest: StationaryTip, distance: float, earlier: Sequence[Verification]) -> Verification:
    """Return what was touched, as a checkpoint that is new or one of the ``earlier`` places."""
    first = {each.checkpoint: each for each in reversed(earlier)}
    away = {number: float(np.linalg.norm(rest.position - each.position))
            for number, each in first.items()}
    nearest = min(away, key=away.__getitem__, default=0)
    again = nearest > 0 and away[nearest] <= SAME_PLACE
    return Verification(rest.position, distance, rest.stamp,
                        nearest if again else max(first, default=0) + 1,
                        away[nearest] if again else None)


def measured_anew(verifications: Sequence[Verification], field: Field,
                  T_bone_tracker: Array) -> list[Verification]:
    """Return them as they lie on the bone when it is registered anew."""
    return [replace(each, distance_m=distance_to(field, T_bone_tracker, each.position))
            for each in verifications]


def sentence(now: Verification, earlier: Sequence[Verification], limit: float) -> str:
    """Return what a verification says in plain words, ``limit`` in m."""
    side = 'inside' if now.distance_m < 0.0 else 'outside'
    verdict = 'within' if abs(now.distance_m) <= limit else 'beyond'
    words = (f'the tip is {1e3 * abs(now.distance_m):.1f} mm {side} the registered surface, '
             f'{verdict} the {1e3 * limit:.1f} mm allowed')
    if now.moved_m is None:
        return f'{words}; this is checkpoint {now.checkpoint}, touch it again later'
    since = now.stamp - min(each.stamp for each in earlier if each.checkpoint == now.checkpoint)
    ago = f'{since:.0f} s' if since < 120.0 else f'{since / 60.0:.0f} min'
    bumped = ': was the array bumped?' if now.moved_m > limit else ''
    return (f'{words}; checkpoint {now.checkpoint} moved {1e3 * now.moved_m:.1f} mm since it was '
            f'first touched {ago} ago{bumped}')


def summary(verifications: Sequence[Verification], limit: float) -> VerificationSummary | None:
    """Return all of them at a glance, each checkpoint as touched last; None without any."""
    if not verifications:
        return None
    last = {each.checkpoint: each for each in verifications}.values()
    distances = np.array([each.distance_m for each in last])
    moved = [each.moved_m for each in last if each.moved_m is not None]
    return VerificationSummary(len(last), float(np.abs(distances).max()),
                               float(np.sqrt(np.mean(distances**2))), max(moved, default=None),
                               limit)
