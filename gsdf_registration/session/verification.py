# SPDX-License-Identifier: Apache-2.0
"""
Verification points: places touched after registration and never used in the fit.

Their distance to the registered surface measures its error there.  A place that is touched again is
a checkpoint: if it moved in the session frame, the array that carries this frame was displaced,
which no other number shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.tool_pose import ToolPose, tip_position
from gsdf_registration.field import Field
from gsdf_registration.session.stationary_tip import StationaryTip

SAME_PLACE = 0.005      # m; a touch nearer than this to an earlier place repeats it


@dataclass(frozen=True)
class Verification:
    """A point touched on the bone after registration."""

    position: Array         # (3,) m, session frame
    distance_m: float       # signed, to the surface as last registered; negative: inside
    stamp: float            # s
    checkpoint: int         # number of the place, from 1
    moved_m: float | None   # since the place was first touched; None: first touch
    tool: ToolPose | None = None    # mean pose of the tool, session frame; None: not received

    def within(self, limit: float) -> bool:
        """Return whether distance and displacement are within ``limit``, m."""
        return max(abs(self.distance_m), self.moved_m or 0.0) <= limit


@dataclass(frozen=True)
class VerificationSummary:
    """All verification points together; metres."""

    points: int
    worst_m: float          # largest distance to the surface, unsigned
    rms_m: float
    moved_m: float | None   # largest displacement of a checkpoint at its last touch; None: none
    limit_m: float
    distances_m: dict[int, float]     # signed, at the last touch of each checkpoint

    @property
    def good(self) -> bool:
        """Whether all are within the limit."""
        return max(self.worst_m, self.moved_m or 0.0) <= self.limit_m

    @property
    def sentence(self) -> str:
        """The summary in one sentence."""
        text = (f'{format_count(self.points, "verification point")}: worst '
                f'{1e3 * self.worst_m:.1f} mm, {1e3 * self.rms_m:.1f} mm RMS')
        if self.moved_m is not None:
            text += f', checkpoints moved by up to {1e3 * self.moved_m:.1f} mm'
        return text + f', {"within" if self.good else "beyond"} {1e3 * self.limit_m:.1f} mm'


def surface_distance(field: Field, T_bone_tracker: Array, position: Array) -> float:
    """Return the signed distance of ``position`` (3,), m, to the registered surface, m."""
    return float(field.sample(transform(T_bone_tracker, position)[None])[0][0])


def make_verification(tip: StationaryTip, distance: float,
                      earlier: Sequence[Verification]) -> Verification:
    """Return a verification point: a new checkpoint, or one of the ``earlier`` ones again."""
    first = {each.checkpoint: each for each in reversed(earlier)}
    away = {number: float(np.linalg.norm(tip.position - each.position))
            for number, each in first.items()}
    nearest = min(away, key=away.__getitem__, default=0)
    again = nearest > 0 and away[nearest] <= SAME_PLACE
    return Verification(tip.position, distance, tip.stamp,
                        nearest if again else max(first, default=0) + 1,
                        away[nearest] if again else None, tip.tool)


def with_tip(verifications: Sequence[Verification],
             tip: Sequence[float]) -> list[Verification]:
    """
    Return the verification points with their positions computed again from the tool poses.

    Their distances to the surface stay those that were measured, see `measured_again`.
    """
    moved, first = [], dict[int, Array]()
    for each in verifications:
        position = each.position if each.tool is None else np.array(tip_position(each.tool, tip))
        start = first.setdefault(each.checkpoint, position)
        distance = None if each.moved_m is None else float(np.linalg.norm(position - start))
        moved.append(replace(each, position=position, moved_m=distance))
    return moved


def measured_again(verifications: Sequence[Verification], field: Field,
                   T_bone_tracker: Array) -> list[Verification]:
    """Return the verification points with their distances to a newly registered surface."""
    return [replace(each, distance_m=surface_distance(field, T_bone_tracker, each.position))
            for each in verifications]


def describe(latest: Verification, earlier: Sequence[Verification], limit: float) -> str:
    """Return a sentence on the latest verification point; ``limit`` in m."""
    side = 'inside' if latest.distance_m < 0.0 else 'outside'
    verdict = 'within' if abs(latest.distance_m) <= limit else 'beyond'
    text = (f'the tip is {1e3 * abs(latest.distance_m):.1f} mm {side} the registered surface, '
            f'{verdict} the {1e3 * limit:.1f} mm allowed')
    if latest.moved_m is None:
        return f'{text}; this is checkpoint {latest.checkpoint}, touch it again later'
    since = latest.stamp - min(each.stamp for each in earlier
                               if each.checkpoint == latest.checkpoint)
    ago = f'{since:.0f} s' if since < 120.0 else f'{since / 60.0:.0f} min'
    displaced = ': was the array displaced?' if latest.moved_m > limit else ''
    return (f'{text}; checkpoint {latest.checkpoint} moved {1e3 * latest.moved_m:.1f} mm since it '
            f'was first touched {ago} ago{displaced}')


def summarize(verifications: Sequence[Verification], limit: float) -> VerificationSummary | None:
    """Return a summary of the last touch of each checkpoint; None if there is none."""
    if not verifications:
        return None
    last = {each.checkpoint: each for each in verifications}.values()
    distances = np.array([each.distance_m for each in last])
    moved = [each.moved_m for each in last if each.moved_m is not None]
    return VerificationSummary(len(last), float(np.abs(distances).max()),
                               float(np.sqrt(np.mean(distances**2))), max(moved, default=None),
                               limit, {each.checkpoint: each.distance_m for each in last})
