# SPDX-License-Identifier: Apache-2.0
"""Report how much of each stroke lies on the bone, and how well it fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.point_filters import first_duplicate
from gsdf_registration.common.result import INLIER_WEIGHT
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points

# A stroke is interference if at most this share of it lies on the bone; the split between two
# strokes may leave a few points of the neighbouring stroke in it
MAX_SHARE = 0.2
MIN_POINTS = 12     # of a stroke that is classified as interference


@dataclass(frozen=True)
class StrokeReport:
    """The fit of one stroke."""

    number: int             # as in `Points.strokes`
    points: int
    share_on_bone: float    # 0 to 1
    rms_m: float | None     # residuals of the points on the bone, root mean square; None if none
    interference: bool      # whether hardly any point lies on the bone

    @property
    def sentence(self) -> str:
        """The report as a sentence."""
        on_bone = round(self.share_on_bone * self.points)
        words = (f'stroke {self.number}: {format_count(self.points, "point")}, '
                 f'{on_bone or "none"} on the bone')
        if self.rms_m is not None:
            words += f', {1e3 * self.rms_m:.2f} mm RMS'
        return words + (': interference; the registration ignores it' if self.interference else '')


def report_strokes(points: Points, residuals: Array, weights: Array) -> list[StrokeReport]:
    """
    Return a report of each stroke, in the order of their numbers.

    Parameters
    ----------
    points : Points
        n points.
    residuals : (n,) float, metres
        Signed distances to the bone at the pose; NaN for an isolated point, which was not used.
    weights : (n,) float
        Probability that a point lies on the bone.

    """
    # a repeated reading was not used, but fits as well as the first one
    first = first_duplicate(points.positions)
    weights, residuals = weights[first], residuals[first]
    on_bone = (weights > INLIER_WEIGHT) & np.isfinite(residuals)
    numbers, stroke = np.unique(points.strokes, return_inverse=True)
    total = np.bincount(stroke, minlength=len(numbers))
    good = np.bincount(stroke[on_bone], minlength=len(numbers))
    squares = np.bincount(stroke[on_bone], residuals[on_bone]**2, minlength=len(numbers))
    return [
        StrokeReport(number, count, on / count, float(np.sqrt(square / on)) if on else None,
                     count >= MIN_POINTS and on <= MAX_SHARE * count)
        for number, count, on, square in zip(numbers.tolist(), total.tolist(), good.tolist(),
                                             squares.tolist())]


def interference_message(reports: Sequence[StrokeReport]) -> str:
    """Return one sentence that names the strokes of interference; empty if there are none."""
    found = [each for each in reports if each.interference]
    if len(found) < 2:
        return ''.join(each.sentence for each in found)
    *most, last = (str(each.number) for each in found)
    return (f'strokes {", ".join(most)} and {last} have {sum(each.points for each in found)} '
            'points, hardly any on the bone: interference; the registration ignores them')
