# SPDX-License-Identifier: Apache-2.0
"""Which tip rests, and where."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.config import LandmarksConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.session.stationary_tip import MOST_SAMPLES, StationaryTipDetector

CONFIG = LandmarksConfig(dwell=0.5, radius=0.002)
RATE = 80.0


def hold(tip: StationaryTipDetector,
         at: tuple[float, float, float],
         start: float,
         seconds: float,
         source: int = 0,
         sigma: float = 0.0,
         arrival: float | None = None) -> float:
    """Hold the tip still and return the time after it."""
    noise = np.random.default_rng(1).normal(0.0, sigma, (round(seconds * RATE) + 1, 3))
    for i, offset in enumerate(noise):
        tip.add(start + i / RATE, tuple((np.array(at) + offset).tolist()), source, arrival)
    return start + (len(noise) + 1) / RATE


def move(tip: StationaryTipDetector, start: float, seconds: float, source: int = 0) -> float:
    for i in range(round(seconds * RATE)):
        tip.add(start + i / RATE, (0.1 * i / RATE, 0.0, 0.0), source)
    return start + (round(seconds * RATE) + 1) / RATE


def test_a_resting_tip_is_averaged_over_the_dwell_only() -> None:
    tip = StationaryTipDetector(CONFIG)
    end = move(tip, 0.0, 2.0)
    hold(tip, (0.3, 0.2, 0.1), end, 1.0, sigma=0.0003)
    rest = tip.rest()
    assert rest.position == pytest.approx([0.3, 0.2, 0.1], abs=0.0003)
    assert 0.0002 < rest.spread_rms < 0.0008 <= rest.spread_max
    assert rest.samples == pytest.approx(0.5 * RATE + 1, abs=1)


@pytest.mark.parametrize('sigma', [0.0, 0.0001])
def test_a_frozen_tip_rests_too(sigma: float) -> None:
    tip = StationaryTipDetector(CONFIG)
    hold(tip, (0.0, 0.0, 0.0), 1.7e9, 0.6, sigma=sigma)
    assert tip.rest().spread_max <= 6.0 * sigma


def test_a_tip_that_was_never_seen_does_not_rest() -> None:
    with pytest.raises(InputError, match='no probe tip is seen'):
        StationaryTipDetector(CONFIG).rest()


def test_a_tip_that_moves_is_refused_with_how_far() -> None:
    tip = StationaryTipDetector(CONFIG)
    move(tip, 0.0, 2.0)
    with pytest.raises(InputError,
                       match=r'the tip moves: 25\.0 mm within the last 0\.5 s, 2\.0 mm allowed'):
        tip.rest()


def test_a_tip_seen_too_shortly_or_with_a_break_is_refused() -> None:
    tip = StationaryTipDetector(CONFIG)
    end = hold(tip, (0.0, 0.0, 0.0), 0.0, 0.4)
    with pytest.raises(InputError, match='not been seen'):
        tip.rest()
    hold(tip, (0.0, 0.0, 0.0), end + 0.3, 0.4)      # lost for 0.3 s in between
    with pytest.raises(InputError, match='not been seen'):
        tip.rest()


def test_a_tip_not_seen_of_late_is_left_out() -> None:
    tip = StationaryTipDetector(CONFIG)
    hold(tip, (0.0, 0.0, 0.0), 0.0, 1.0, arrival=50.0)
    assert tip.rest(now=50.1).samples
    with pytest.raises(InputError, match='no probe tip is seen'):
        tip.rest(now=51.0)


def test_of_two_resting_tips_the_one_that_came_to_rest_last_is_meant() -> None:
    tip = StationaryTipDetector(CONFIG)
    hold(tip, (1.0, 0.0, 0.0), 0.0, 4.0, source=0)       # lies on the table all the time
    end = move(tip, 0.0, 2.0, source=1)
    hold(tip, (0.5, 0.0, 0.0), end, 2.0, source=1)
    assert tip.rest().position == pytest.approx([0.5, 0.0, 0.0])


def test_a_tip_on_the_table_does_not_hide_one_that_rests_nor_one_that_moves() -> None:
    tip = StationaryTipDetector(CONFIG)
    hold(tip, (1.0, 0.0, 0.0), 0.0, 2.0, source=0)
    move(tip, 0.0, 2.0, source=1)
    assert tip.rest().position == pytest.approx([1.0, 0.0, 0.0])


def test_memory_is_bounded_whatever_the_stamps_say() -> None:
    tip = StationaryTipDetector(CONFIG)
    for i in range(MOST_SAMPLES + 100):
        tip.add(i * 1e-9, (0.0, 0.0, 0.0))
    assert len(tip._sources[0].samples) == MOST_SAMPLES


def test_a_few_wild_readings_are_no_motion_and_not_in_the_mean() -> None:
    tip = StationaryTipDetector(CONFIG)
    for i in range(81):
        wild = i in (50, 63, 78)
        tip.add(i / RATE, (0.3 if wild else 0.1, 0.0, 0.0))
    rest = tip.rest()
    assert rest.position == pytest.approx([0.1, 0.0, 0.0]) and rest.spread_max == pytest.approx(0.0)
    assert rest.samples == 38
    assert rest.since == 0.0        # and they do not make it come to rest anew


@pytest.mark.parametrize('late', [1, 3])
def test_a_tip_that_has_not_come_yet_or_goes_already_does_not_rest(late: int) -> None:
    for places in ([0.0] * late + [0.1] * (41 - late), [0.1] * (41 - late) + [0.3] * late):
        tip = StationaryTipDetector(CONFIG)
        for i, x in enumerate(places):
            tip.add(i / RATE, (x, 0.0, 0.0))
        with pytest.raises(InputError, match='the tip moves'):
            tip.rest()


def test_many_readings_elsewhere_are_motion() -> None:
    tip = StationaryTipDetector(CONFIG)
    for i in range(81):
        tip.add(i / RATE, (0.3 if i % 6 == 0 else 0.1, 0.0, 0.0))
    with pytest.raises(InputError, match='the tip moves'):
        tip.rest()


@pytest.mark.parametrize('speed', [0.02, 0.1, 0.8])
def test_it_is_known_since_when_a_tip_rests(speed: float) -> None:
    tip = StationaryTipDetector(CONFIG)
    for i in range(80):
        tip.add(i / RATE, (speed * i / RATE, 0.0, 0.0), source=7)
    came = 80 / RATE
    hold(tip, (speed, 0.0, 0.0), came, 1.0, source=7, sigma=0.0001)
    rest = tip.rest()
    assert rest.source == 7
    # not later than it came, so that nothing of the rest is missed, nor long before
    assert came - 2.0 * 2.0 * CONFIG.radius / speed - 1.5 / RATE <= rest.since <= came
