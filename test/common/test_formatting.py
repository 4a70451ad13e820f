# SPDX-License-Identifier: Apache-2.0
"""Numbers and lengths in messages."""

from __future__ import annotations

import pytest

from gsdf_registration.common.formatting import format_numbers


@pytest.mark.parametrize('numbers, text', [
    ([], ''), ([3], '3'), ([1, 2, 4], '1, 2, 4'), ([1, 2, 3, 7, 8, 9, 10], '1 to 3, 7 to 10')])
def test_formats_ranges_of_numbers(numbers: list[int], text: str) -> None:
    assert format_numbers(numbers) == text
