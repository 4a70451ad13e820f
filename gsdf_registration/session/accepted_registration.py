# SPDX-License-Identifier: Apache-2.0
"""The last good pose, and the points it was found with: what is still true of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.registration.stroke_report import StrokeReport, report


@dataclass(frozen=True, eq=False)
class AcceptedRegistration:
    """A good registration of n points; ``serials`` (n,) are theirs in the collection, rising."""

    result: RegistrationResult
    points: Points
    serials: NDArray[np.int64]
    frame_id: str       # of the points, and so of the pose

    def outdated(self, serials: NDArray[np.int64]) -> bool:
        """Tell whether any of its points is missing from those now held, ``serials`` (m,)."""
        return not np.isin(self.serials, serials, assume_unique=True).all()

    def fit(self, serials: NDArray[np.int64]) -> tuple[Array, Array]:
        """
        Return residuals, m, and weights (m,) of the points now held.

        Where a point was not given to the registration, its weight is NaN; where it was left out as
        a stray, only its residual is.
        """
        residuals, weights = np.full(len(serials), np.nan), np.full(len(serials), np.nan)
        if self.result.residuals_m is not None and self.result.weights is not None:
            row = np.searchsorted(self.serials, serials)
            in_it = row < len(self.serials)
            in_it[in_it] = self.serials[row[in_it]] == serials[in_it]
            residuals[in_it] = self.result.residuals_m[row[in_it]]
            weights[in_it] = self.result.weights[row[in_it]]
        return residuals, weights

    def reports(self, points: Points, serials: NDArray[np.int64]) -> tuple[StrokeReport, ...]:
        """Return what the strokes of ``points`` now held, those that were in it, are worth."""
        residuals, weights = self.fit(serials)
        in_it = ~np.isnan(weights)
        return tuple(report(Points(*(column[in_it] for column in points)), residuals[in_it],
                            weights[in_it]))

    def holds(self, source: int, since: float) -> bool:
        """Tell whether it was found with anything that ``source`` delivered ``since`` then, s."""
        return bool(((self.points.sources == source) & (self.points.stamps >= since)).any())
