# SPDX-License-Identifier: Apache-2.0
"""The accepted registration: its result and the points it was computed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.registration.stroke_report import StrokeReport, report_strokes


@dataclass(frozen=True, eq=False)
class AcceptedRegistration:
    """A successful registration of n points; points and serials are views, see `Collection`."""

    result: RegistrationResult
    points: Points
    serials: NDArray[np.int64]      # (n,) of the points in the collection, ascending
    frame_id: str       # of the points, and so of the pose

    @property
    def newest(self) -> float:
        """Stamp of its newest point, s."""
        return float(self.points.stamps[-1]) if len(self.points.stamps) else 0.0

    def outdated(self, serials: NDArray[np.int64]) -> bool:
        """Return whether any of its points is missing in the collection, ``serials`` (m,)."""
        row = np.searchsorted(serials, self.serials)
        return len(self.serials) > 0 and bool(
            row[-1] == len(serials) or (serials[row] != self.serials).any())

    def fit(self, serials: NDArray[np.int64]) -> tuple[Array, Array]:
        """
        Return residuals, m, and weights (m,) of the points in the collection, ``serials`` (m,).

        The weight of a point that was not registered is NaN.  The residual is NaN also for a point
        that the registration left out as an outlier or as a repeated reading.
        """
        residuals, weights = np.full(len(serials), np.nan), np.full(len(serials), np.nan)
        if self.result.residuals_m is not None and self.result.weights is not None:
            row = np.searchsorted(self.serials, serials)
            registered = row < len(self.serials)
            registered[registered] = self.serials[row[registered]] == serials[registered]
            residuals[registered] = self.result.residuals_m[row[registered]]
            weights[registered] = self.result.weights[row[registered]]
        return residuals, weights

    def reports(self, points: Points, serials: NDArray[np.int64]) -> tuple[StrokeReport, ...]:
        """Return a report of each stroke of ``points``, for the points that were registered."""
        residuals, weights = self.fit(serials)
        registered = ~np.isnan(weights)
        return tuple(report_strokes(Points(*(column[registered] for column in points)),
                            residuals[registered], weights[registered]))

    @property
    def uses_tools(self) -> bool:
        """Whether it used a point that was received as the pose of a tool."""
        return not np.isnan(self.points.tools).all()

    def uses(self, source: int, since: float) -> bool:
        """Return whether it used a point of ``source`` stamped ``since``, s, or later."""
        return bool(((self.points.sources == source) & (self.points.stamps >= since)).any())
