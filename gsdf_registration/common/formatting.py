# SPDX-License-Identifier: Apache-2.0
"""Numbers as people say them."""

from __future__ import annotations


def counted(number: int, noun: str, plural: str = '') -> str:
    """Return a number with its noun: 1 point, 2 points, 3 bodies; the plural if it is no -s."""
    return f'{number} {noun if number == 1 else plural or noun + "s"}'


def length(metres: float) -> str:
    """Return a length in the unit that suits it, to a hundredth of a millimetre at best."""
    return f'{metres:.3g} m' if metres >= 1.0 else f'{round(1e3 * metres, 2):.3g} mm'


def expected_error(metres: float) -> str:
    """Return an expected error in millimetres, to a tenth; never 0.0 mm."""
    return f'{1e3 * metres:.1f} mm' if metres >= 5e-5 else '< 0.1 mm'
