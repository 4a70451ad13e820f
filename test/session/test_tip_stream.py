# SPDX-License-Identifier: Apache-2.0
"""A tip that lifts off the bone and lands again: where strokes are split, and where not."""

from __future__ import annotations

import numpy as np
import pytest
from dragging import RATE, SPEED, collection, drag
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.samples import AGREEING, Rejection


def lifted(count: int, arc: int, times: float, rate: float = RATE,
           speed: float = SPEED) -> np.ndarray:
    """Return a stroke at ``speed``, m/s, an arc so many times as fast, and another stroke."""
    steps = np.repeat([speed, times * speed, speed], [count, arc, count])
    noise = np.random.default_rng(0).normal(0.0, 1e-4, (len(steps), 3))
    return noise + np.outer(np.cumsum(steps) / rate, [1.0, 0.0, 0.0])


def strokes_of(positions: np.ndarray, rate: float = RATE, **gate: float) -> np.ndarray:
    c = collection(**gate)
    for i, position in enumerate(positions):
        assert c.add(i / rate, position, 'cam') is None
    return c.arrays().strokes


@pytest.mark.parametrize('rate', [40.0, 80.0, 1000.0])
@pytest.mark.parametrize('speed', [0.015, 0.03, 0.08])
def test_a_tip_that_lifts_off_and_lands_begins_a_stroke_each_time(rate: float,
                                                                  speed: float) -> None:
    count, arc = round(4.0 * rate), round(0.6 * rate)
    strokes = strokes_of(lifted(count, arc, 6.0, rate, speed), rate)
    assert set(strokes) == {1, 2, 3}
    lag = round(0.2 * rate) + AGREEING
    assert (strokes[:count] == 1).all()
    assert (strokes[count + lag:count + arc] == 2).all()
    assert (strokes[count + arc + lag:] == 3).all()


def test_a_hand_that_is_not_quick_and_a_short_jerk_do_not_split() -> None:
    assert set(strokes_of(lifted(800, 40, 2.0))) == {1}
    assert set(strokes_of(lifted(800, 2, 4.0))) == {1}
    assert set(strokes_of(lifted(800, 40, 4.0), lift_ratio=0.0)) == {1}
    assert set(strokes_of(lifted(800, 40, 4.0), lift_ratio=5.0)) == {1}


def test_a_tip_that_rests_and_goes_on_has_not_lifted_off() -> None:
    drag = lifted(200, 0, 0.0, speed=0.03)
    rest = np.random.default_rng(1).normal(drag[199], 1e-4, (800, 3))
    assert set(strokes_of(np.vstack([drag[:200], rest, drag[200:]]))) == {1}


def test_who_waves_the_tip_about_before_a_stroke_still_lifts_off_after_it() -> None:
    turn = 3.0 * np.arange(1600)[:, None] / RATE
    waved = 0.1 * np.hstack([np.sin(turn), np.cos(turn), 0.0 * turn])   # 0.3 m/s for 20 s
    strokes = strokes_of(np.vstack([waved, waved[-1] + lifted(400, 60, 6.0, speed=0.03)]))
    assert len(set(strokes[1600 + 60:1600 + 400])) == 1
    assert len({strokes[1500], strokes[1600 + 200], strokes[1600 + 440]}) == 3


def test_a_wild_point_is_no_lift_off() -> None:
    positions = lifted(200, 0, 0.0)
    positions[100, 1] += 0.011       # not quite too fast
    assert set(strokes_of(positions)) == {1}


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0.0, 0.9), max_size=8))
def test_splitting_loses_no_point(speeds: list[float]) -> None:
    positions = np.outer(np.cumsum(np.repeat(speeds, 30)) / RATE, [1.0, 0.0, 0.0])
    c = collection()
    kept = [c.add(i / RATE, p, 'cam') in (None, Rejection.DUPLICATE)
            for i, p in enumerate(positions)]
    assert all(kept) and c.received == len(c) + c.counts['duplicate']


def test_undo_says_what_split_the_stroke_off() -> None:
    c = collection()
    for i, position in enumerate(lifted(200, 40, 6.0)):
        c.add(i / RATE, position, 'cam')
    drag(c, 10, first=1000)
    c.start_stroke()
    drag(c, 10, first=1010)
    parts = [c.undo() for _ in range(5)]
    assert [part and part.split_by for part in parts] == ['', 'silence', 'landing', 'lift-off', '']
    assert c.undone == 460 and c.undo() is None
