# SPDX-License-Identifier: Apache-2.0
"""What each stroke is worth: how much of it lies on the bone, and how well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.point_filters import first_duplicate
from gsdf_registration.common.result import INLIER_WEIGHT
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points

# a stroke is interference if no larger share of it lies on the bone: where it is split, a few
# points of the one before or after are in it
INTERFERENCE = 0.2
FEWEST = 12         # points of a stroke that is called interference; of fewer nothing is said


@dataclass(frozen=True)
class StrokeReport:
    """A stroke at the pose found with it."""

    number: int             # as in `Points.strokes`
    points: int
    share_on_bone: float    # 0 to 1
    rms_m: float | None     # residuals of those on the bone, root mean square; None without any
    interference: bool      # whether (nearly) none of it lies on the bone

    @property
    def sentence(self) -> str:
        """Return the report in plain words."""
        on_bone = round(self.share_on_bone * self.points)
        words = (f'stroke {self.number}: {format_count(self.points, "point")}, '
                 f'{on_bone or "none"} on the bone')
        if self.rms_m is not None:
            words += f', {1e3 * self.rms_m:.2f} mm RMS'
        return words + (': interference; undo it or leave it' if self.interference else '')


def report(points: Points, residuals: Array, weights: Array) -> list[StrokeReport]:
    """
    Return a report of each stroke, in the order of their numbers.

    Parameters
    ----------
    points : Points
        n of them.
    residuals : (n,) float, metres
        Signed distances to the bone at the pose found; NaN: a stray point that was left out.
    weights : (n,) float
        Probability that a point lies on the bone.

    """
    # a reading repeated is not used again, and as good as it was the first time
    first = first_duplicate(points.positions)
    weights, residuals = weights[first], residuals[first]
    on_bone = (weights > INLIER_WEIGHT) & np.isfinite(residuals)
    numbers, stroke = np.unique(points.strokes, return_inverse=True)
    total = np.bincount(stroke, minlength=len(numbers))
    good = np.bincount(stroke[on_bone], minlength=len(numbers))
    squares = np.bincount(stroke[on_bone], residuals[on_bone]**2, minlength=len(numbers))
    return [
        StrokeReport(number, count, on / count, float(np.sqrt(square / on)) if on else None,
                     count >= FEWEST and on <= INTERFERENCE * count)
        for number, count, on, square in zip(numbers.tolist(), total.tolist(), good.tolist(),
                                             squares.tolist())]


def interference(reports: Sequence[StrokeReport]) -> str:
    """Name the strokes that are all interference in one sentence; empty if there are none."""
    named = [each for each in reports if each.interference]
    if len(named) < 2:
        return ''.join(each.sentence for each in named)
    *most, last = (str(each.number) for each in named)
    return (f'strokes {", ".join(most)} and {last} hold {sum(each.points for each in named)} '
            'points, hardly any on the bone: interference; undo them or leave them')
