# SPDX-License-Identifier: Apache-2.0
"""The share of each stroke on the bone, and strokes of interference."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.samples import Points, without_tools
from gsdf_registration.registration.stroke_report import (
    MIN_POINTS,
    StrokeReport,
    interference_message,
    report_strokes,
)


def points(strokes: list[int]) -> Points:
    n = len(strokes)
    return without_tools(np.arange(3.0 * n).reshape(n, 3), np.arange(n, dtype=float),
                         np.array(strokes, np.int32), np.zeros(n, np.int32))


def test_reports_share_and_residual_of_each_stroke() -> None:
    found = report_strokes(points([1, 1, 4, 4, 1, 4]),
                           np.array([3e-4, -4e-4, 1e-2, 1e-4, 9.0, -1e-4]),
                           np.array([1.0, 0.9, 0.0, 0.8, 0.2, 0.6]))
    assert [(each.number, each.points) for each in found] == [(1, 3), (4, 3)]
    assert found[0].share_on_bone == found[1].share_on_bone == pytest.approx(2 / 3)
    assert found[0].rms_m == pytest.approx(np.sqrt((9e-8 + 16e-8) / 2))
    assert found[1].rms_m == pytest.approx(1e-4)
    assert found[0].sentence == 'stroke 1: 3 points, 2 on the bone, 0.35 mm RMS'
    assert not any(each.interference for each in found)


def test_without_points_there_are_no_reports() -> None:
    assert report_strokes(points([]), np.zeros(0), np.zeros(0)) == []


def test_a_stroke_off_the_bone_is_interference() -> None:
    strokes = [1] * 50 + [3] * 212
    weights = np.r_[np.ones(50), np.zeros(212)]
    found = report_strokes(points(strokes), np.full(262, 1e-4), weights)
    assert [each.interference for each in found] == [False, True]
    assert found[1].rms_m is None
    assert interference_message(found) == found[1].sentence == (
        'stroke 3: 212 points, none on the bone: interference; the registration ignores it')


def test_isolated_points_are_not_on_the_bone() -> None:
    found = report_strokes(points([2] * 20), np.full(20, np.nan), np.ones(20))
    assert found[0].interference and found[0].rms_m is None


def test_a_repeated_stroke_has_the_same_report() -> None:
    once = points([1] * 30)
    twice = without_tools(np.tile(once.positions, (2, 1)), np.arange(60.0),
                          np.repeat(np.array([1, 2], np.int32), 30), np.zeros(60, np.int32))
    # a registration does not use repeated readings
    first, again = report_strokes(twice, np.r_[np.full(30, 2e-4), np.full(30, np.nan)],
                          np.r_[np.ones(30), np.zeros(30)])
    assert again.share_on_bone == first.share_on_bone == 1.0 and again.rms_m == first.rms_m


def test_a_few_points_do_not_change_the_classification() -> None:
    weights = np.zeros(50)
    weights[:8] = 1.0
    assert report_strokes(points([1] * 50), np.zeros(50), weights)[0].interference
    assert not report_strokes(points([1] * 50), np.zeros(50), 1.0 - weights)[0].interference


def test_a_stroke_of_few_points_is_not_classified() -> None:
    for count in (MIN_POINTS - 1, MIN_POINTS):
        found = report_strokes(points([1] * count), np.zeros(count), np.zeros(count))
        assert found[0].interference == (count >= MIN_POINTS)


def test_several_strokes_are_named_in_one_sentence() -> None:
    bad = [StrokeReport(number, 30, 0.0, None, True) for number in (2, 5, 6)]
    assert interference_message([StrokeReport(1, 90, 1.0, 1e-4, False)]) == ''
    assert interference_message(bad) == (
        'strokes 2, 5 and 6 have 90 points, hardly any on the bone: interference; the registration '
        'ignores them')
