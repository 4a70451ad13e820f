# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: which place is meant, how far it has moved, and all of them at a glance."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.session.stationary_tip import StationaryTip
from gsdf_registration.session.verification import (
    SAME_PLACE,
    Verification,
    sentence,
    summary,
    verified,
)

LIMIT = 0.002


def rest(x: float, stamp: float) -> StationaryTip:
    return StationaryTip(np.array([x, 0.0, 0.0]), 0.0, 0.0, 40, stamp, 0, stamp - 1.0)


def touched(*places: float, distance: float = 0.0005) -> list[Verification]:
    """Return the verification points of one touch a minute."""
    found: list[Verification] = []
    for count, x in enumerate(places):
        found.append(verified(rest(x, 60.0 * count), distance, found))
    return found


def test_a_place_touched_again_is_the_same_checkpoint() -> None:
    found = touched(0.0, 0.02, 0.0204, 0.001)
    assert [each.checkpoint for each in found] == [1, 2, 2, 1]
    assert [each.moved_m for each in found] == [None, None, pytest.approx(0.0004),
                                                pytest.approx(0.001)]


def test_what_moved_is_measured_from_the_first_touch() -> None:
    found = touched(0.0, 0.002, 0.004)      # it creeps: each touch is near the one before
    assert found[-1].checkpoint == 1 and found[-1].moved_m == pytest.approx(0.004)
    assert touched(0.0, 1.1 * SAME_PLACE)[-1].checkpoint == 2


def test_a_checkpoint_that_moved_asks_whether_the_array_was_bumped() -> None:
    found = touched(0.0, 0.03, 0.0034)
    assert sentence(found[2], found[:2], LIMIT) == (
        'the tip is 0.5 mm outside the registered surface, within the 2.0 mm allowed; checkpoint 1 '
        'moved 3.4 mm since it was first touched 2 min ago: was the array bumped?')
    still = touched(0.0, 0.0003)
    assert sentence(still[1], still[:1], LIMIT).endswith(
        'checkpoint 1 moved 0.3 mm since it was first touched 60 s ago')
    assert 'this is checkpoint 1, touch it again later' in sentence(still[0], [], LIMIT)


def test_the_summary_takes_each_place_as_touched_last() -> None:
    assert summary([], LIMIT) is None
    found = touched(0.0, 0.03, distance=-0.003) + [verified(rest(0.03, 120.0), 0.001,
                                                            touched(0.0, 0.03))]
    glance = summary(found, LIMIT)
    assert glance is not None and not glance.good
    assert (glance.points, glance.worst_m) == (2, 0.003)
    assert glance.rms_m == pytest.approx(np.sqrt((9e-6 + 1e-6) / 2))
    assert glance.sentence == ('2 verification points: worst 3.0 mm, 2.2 mm RMS, checkpoints moved '
                               'by up to 0.0 mm, beyond 2.0 mm')
    moved = summary(touched(0.0, 0.0034), LIMIT)
    assert moved is not None and moved.worst_m < LIMIT and not moved.good
    one = summary(touched(0.0), LIMIT)
    assert one is not None and one.good and one.moved_m is None
    assert one.sentence == '1 verification point: worst 0.5 mm, 0.5 mm RMS, within 2.0 mm'
