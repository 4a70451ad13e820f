# SPDX-License-Identifier: Apache-2.0
"""Numbers as people say them."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: 1 point, 2 points."""
    return f'{number} {noun}{"" if number == 1 else "s"}'


def length(metres: float) -> str:
    """Return a length in the unit that suits it."""
    return f'{metres:.3g} m' if metres >= 1.0 else f'{1e3 * metres:.3g} mm'
