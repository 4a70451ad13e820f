# SPDX-License-Identifier: Apache-2.0
"""Time stamps as ROS keeps them (whole seconds and nanoseconds) and as floating-point seconds."""

from __future__ import annotations


def to_seconds(sec: int, nanosec: int) -> float:
    """Return a stamp in seconds; float64 resolves 0.24 us at today's date."""
    return sec + nanosec * 1e-9


def to_nanoseconds(seconds: float) -> int:
    """Return seconds as whole nanoseconds, rounded to the nearest."""
    whole = int(seconds // 1.0)     # split off first: the fraction is then exact
    return whole * 1_000_000_000 + round((seconds - whole) * 1e9)


def split(nanoseconds: int) -> tuple[int, int]:
    """Return (sec, nanosec) with 0 <= nanosec < 1e9, also before 1970."""
    return divmod(nanoseconds, 1_000_000_000)
