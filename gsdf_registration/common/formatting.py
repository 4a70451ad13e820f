# SPDX-License-Identifier: Apache-2.0
"""Format counts and lengths for messages."""

from __future__ import annotations

from collections.abc import Iterable


def format_count(number: int, noun: str, plural: str = '') -> str:
    """
    Return a number with its noun: 1 point, 2 points, 3 bodies.

    Parameters
    ----------
    number : int
    noun : str, singular
    plural : str, needed if the plural is not the noun with an s

    """
    return f'{number} {noun if number == 1 else plural or noun + "s"}'


def format_length(metres: float) -> str:
    """Return a length in mm, or in m from one metre on, with three significant digits."""
    return f'{metres:.3g} m' if metres >= 1.0 else f'{round(1e3 * metres, 2):.3g} mm'


def format_error(metres: float) -> str:
    """Return an expected error in mm with one decimal, < 0.1 mm instead of 0.0 mm."""
    return f'{1e3 * metres:.1f} mm' if metres >= 5e-5 else '< 0.1 mm'


def format_numbers(numbers: Iterable[int]) -> str:
    """Return ascending numbers, with ranges: 1 to 3, 7."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    return ', '.join(f'{first} to {last}' if last > first + 1 else
                     ', '.join(map(str, range(first, last + 1))) for first, last in ranges)
