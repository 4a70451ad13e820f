# SPDX-License-Identifier: Apache-2.0
"""Strokes are split where the tip lifts off the bone and where it lands."""

from __future__ import annotations

import numpy as np
import pytest
from collection_fixtures import RATE, SPEED, collection, drag
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.samples import AGREEING, Rejection


def lift_off(count: int, arc: int, times: float, rate: float = RATE,
             speed: float = SPEED) -> np.ndarray:
    """Return a stroke at ``speed``, m/s, an arc ``times`` as fast, and another stroke."""
    steps = np.repeat([speed, times * speed, speed], [count, arc, count])
    noise = np.random.default_rng(0).normal(0.0, 1e-4, (len(steps), 3))
    return noise + np.outer(np.cumsum(steps) / rate, [1.0, 0.0, 0.0])


def strokes_of(positions: np.ndarray, rate: float = RATE, **gate: float) -> np.ndarray:
    c = collection(**gate)
    for i, position in enumerate(positions):
        assert c.add_point(i / rate, tuple(position)) is None
    return c.points().strokes


@pytest.mark.parametrize('rate', [40.0, 80.0, 1000.0])
@pytest.mark.parametrize('speed', [0.015, 0.03, 0.08])
def test_lift_off_and_landing_start_strokes(rate: float,
                                            speed: float) -> None:
    count, arc = round(4.0 * rate), round(0.6 * rate)
    strokes = strokes_of(lift_off(count, arc, 6.0, rate, speed), rate)
    assert set(strokes) == {1, 2, 3}
    lag = round(0.2 * rate) + AGREEING
    assert (strokes[:count] == 1).all()
    assert (strokes[count + lag:count + arc] == 2).all()
    assert (strokes[count + arc + lag:] == 3).all()


def test_moderate_speed_and_short_jerks_do_not_split() -> None:
    assert set(strokes_of(lift_off(800, 40, 2.0))) == {1}
    assert set(strokes_of(lift_off(800, 2, 4.0))) == {1}
    assert set(strokes_of(lift_off(800, 40, 4.0), lift_ratio=0.0)) == {1}
    assert set(strokes_of(lift_off(800, 40, 4.0), lift_ratio=5.0)) == {1}


def test_a_pause_is_not_a_lift_off() -> None:
    drag = lift_off(200, 0, 0.0, speed=0.03)
    pause = np.random.default_rng(1).normal(drag[199], 1e-4, (800, 3))
    assert set(strokes_of(np.vstack([drag[:200], pause, drag[200:]]))) == {1}


def test_detects_lift_off_after_fast_motion_in_the_air() -> None:
    turn = 3.0 * np.arange(1600)[:, None] / RATE
    in_air = 0.1 * np.hstack([np.sin(turn), np.cos(turn), 0.0 * turn])   # 0.3 m/s for 20 s
    strokes = strokes_of(np.vstack([in_air, in_air[-1] + lift_off(400, 60, 6.0, speed=0.03)]))
    assert len(set(strokes[1600 + 60:1600 + 400])) == 1
    assert len({strokes[1500], strokes[1600 + 200], strokes[1600 + 440]}) == 3


def test_an_outlier_is_not_a_lift_off() -> None:
    positions = lift_off(200, 0, 0.0)
    positions[100, 1] += 0.011       # not quite too fast
    assert set(strokes_of(positions)) == {1}


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0.0, 0.9), max_size=8))
def test_splitting_loses_no_points(speeds: list[float]) -> None:
    positions = np.outer(np.cumsum(np.repeat(speeds, 30)) / RATE, [1.0, 0.0, 0.0])
    c = collection()
    kept = [c.add_point(i / RATE, tuple(p)) in (None, Rejection.DUPLICATE)
            for i, p in enumerate(positions)]
    assert all(kept) and c.received == len(c) + c.counts['duplicate']


def test_undo_returns_what_split_the_stroke() -> None:
    c = collection()
    for i, position in enumerate(lift_off(200, 40, 6.0)):
        c.add_point(i / RATE, tuple(position))
    drag(c, 10, first=1000)
    c.start_stroke()
    drag(c, 10, first=1010)
    parts = [c.undo() for _ in range(5)]
    assert [part and part.split_by for part in parts] == ['', 'silence', 'landing', 'lift-off', '']
    assert c.counts['undone'] == 460 and c.undo() is None
