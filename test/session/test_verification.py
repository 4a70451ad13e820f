# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: recognition of a place, its displacement, and the summary."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.session.stationary_tip import StationaryTip
from gsdf_registration.session.verification import (
    SAME_PLACE,
    Verification,
    describe,
    make_verification,
    summarize,
)

LIMIT = 0.002


def tip(x: float, stamp: float) -> StationaryTip:
    return StationaryTip(np.array([x, 0.0, 0.0]), 0.0, 0.0, 40, stamp, 0, stamp - 1.0)


def touches(*places: float, distance: float = 0.0005) -> list[Verification]:
    """Return verification points, one per minute."""
    found: list[Verification] = []
    for count, x in enumerate(places):
        found.append(make_verification(tip(x, 60.0 * count), distance, found))
    return found


def test_recognizes_a_checkpoint() -> None:
    found = touches(0.0, 0.02, 0.0204, 0.001)
    assert [each.checkpoint for each in found] == [1, 2, 2, 1]
    assert [each.moved_m for each in found] == [None, None, pytest.approx(0.0004),
                                                pytest.approx(0.001)]


def test_measures_the_displacement_from_the_first_touch() -> None:
    found = touches(0.0, 0.002, 0.004)      # each touch is near the one before
    assert found[-1].checkpoint == 1 and found[-1].moved_m == pytest.approx(0.004)
    assert touches(0.0, 1.1 * SAME_PLACE)[-1].checkpoint == 2


def test_asks_whether_the_array_was_displaced() -> None:
    found = touches(0.0, 0.03, 0.0034)
    assert describe(found[2], found[:2], LIMIT) == (
        'the tip is 0.5 mm outside the registered surface, within the 2.0 mm allowed; checkpoint 1 '
        'moved 3.4 mm since it was first touched 2 min ago: was the array displaced?')
    still = touches(0.0, 0.0003)
    assert describe(still[1], still[:1], LIMIT).endswith(
        'checkpoint 1 moved 0.3 mm since it was first touched 60 s ago')
    assert 'this is checkpoint 1, touch it again later' in describe(still[0], [], LIMIT)


def test_summarizes_the_last_touch_of_each_checkpoint() -> None:
    assert summarize([], LIMIT) is None
    found = touches(0.0, 0.03, distance=-0.003)
    found.append(make_verification(tip(0.03, 120.0), 0.001, touches(0.0, 0.03)))
    total = summarize(found, LIMIT)
    assert total is not None and not total.good
    assert (total.points, total.worst_m) == (2, 0.003)
    assert total.rms_m == pytest.approx(np.sqrt((9e-6 + 1e-6) / 2))
    assert total.sentence == ('2 verification points: worst 3.0 mm, 2.2 mm RMS, checkpoints moved '
                               'by up to 0.0 mm, beyond 2.0 mm')
    moved = summarize(touches(0.0, 0.0034), LIMIT)
    assert moved is not None and moved.worst_m < LIMIT and not moved.good
    one = summarize(touches(0.0), LIMIT)
    assert one is not None and one.good and one.moved_m is None
    assert one.sentence == '1 verification point: worst 0.5 mm, 0.5 mm RMS, within 2.0 mm'
