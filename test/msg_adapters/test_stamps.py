# SPDX-License-Identifier: Apache-2.0
"""Test the conversion of time stamps."""

from __future__ import annotations

from fractions import Fraction

from hypothesis import given, settings
from hypothesis import strategies as st

from msg_adapters import stamps


@settings(deadline=None)
@given(st.integers(-2**22, 2**22), st.integers(0, 999_999_999))
def test_stamps_of_weeks_are_exact_to_the_nanosecond(sec, nanosec):
    assert stamps.split(stamps.to_nanoseconds(stamps.to_seconds(sec, nanosec))) == (sec, nanosec)


@settings(deadline=None)
@given(st.floats(2.0**23, 2.0**31 - 1))
def test_seconds_of_today_are_exact(seconds):
    assert stamps.to_seconds(*stamps.split(stamps.to_nanoseconds(seconds))) == seconds


@settings(deadline=None)
@given(st.floats(-2.0**31, 2.0**31 - 1))
def test_nanoseconds_are_rounded_to_the_nearest(seconds):
    nanoseconds = stamps.to_nanoseconds(seconds)
    assert abs(Fraction(seconds) * 10**9 - nanoseconds) <= Fraction(1, 2) + Fraction(1, 10**6)
    assert 0 <= stamps.split(nanoseconds)[1] < 10**9
