# SPDX-License-Identifier: Apache-2.0
"""Convert time stamps between seconds with nanoseconds, as in ROS, and floating-point seconds."""

from __future__ import annotations


def to_seconds(sec: int, nanosec: int) -> float:
    """Return a stamp in seconds; the resolution of float64 is 0.24 us today."""
    return sec + nanosec * 1e-9


def to_nanoseconds(seconds: float) -> int:
    """Return seconds as whole nanoseconds, rounded to the nearest."""
    whole = int(seconds // 1.0)     # subtracted first, so that the fraction is exact
    return whole * 1_000_000_000 + round((seconds - whole) * 1e9)


def split(nanoseconds: int) -> tuple[int, int]:
    """Return (sec, nanosec) with 0 <= nanosec < 1e9, also before 1970."""
    return divmod(nanoseconds, 1_000_000_000)
