# SPDX-License-Identifier: Apache-2.0
"""A tracked tool of a recording, as arrays in SI units."""

from __future__ import annotations

from dataclasses import dataclass, field

from gsdf_registration.common.rigid import Array


@dataclass(frozen=True, eq=False)
class TrackedTool:
    """
    The samples of a tool that was tracked, with a known position.

    label : port label, or name of the transform
    positions : (n, 3) float64, m
    quaternions : (n, 4) float64, x y z w, NaN where unknown; None if the file has no orientations
    errors : (n,) float64, m, NaN where unknown; None if the file has no errors
    stamps : (n,) float64, s; None if there are no times
    dropped : number of lines without a usable sample, by cause
    """

    label: str
    positions: Array
    quaternions: Array | None = None
    errors: Array | None = None
    stamps: Array | None = None
    dropped: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.positions)
