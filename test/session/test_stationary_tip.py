# SPDX-License-Identifier: Apache-2.0
"""Which tip is stationary, and where."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.config import LandmarksConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.common.samples import Sample
from gsdf_registration.session.stationary_tip import (
    MAX_SAMPLES,
    StationaryTip,
    StationaryTipDetector,
)

CONFIG = LandmarksConfig(dwell=0.5, radius=0.002)
RATE = 80.0


class Detector(StationaryTipDetector):
    """A detector that applies the same settings to every call."""

    def send(self, stamp: float, position: tuple[float, float, float], source: int = 0,
             arrival: float | None = None) -> None:
        self.add(Sample(stamp, position, 'cam', f'/probe_{source}', arrival), source, CONFIG)

    def found(self, now: float | None = None) -> StationaryTip:
        return self.detect(CONFIG, now)


def hold(tip: Detector,
         at: tuple[float, float, float],
         start: float,
         seconds: float,
         source: int = 0,
         sigma: float = 0.0,
         arrival: float | None = None) -> float:
    """Hold the tip still and return the time after it."""
    noise = np.random.default_rng(1).normal(0.0, sigma, (round(seconds * RATE) + 1, 3))
    for i, offset in enumerate(noise):
        tip.send(start + i / RATE, tuple((np.array(at) + offset).tolist()), source, arrival)
    return start + (len(noise) + 1) / RATE


def move(tip: Detector, start: float, seconds: float, source: int = 0) -> float:
    for i in range(round(seconds * RATE)):
        tip.send(start + i / RATE, (0.1 * i / RATE, 0.0, 0.0), source)
    return start + (round(seconds * RATE) + 1) / RATE


def test_averages_over_the_dwell() -> None:
    tip = Detector()
    end = move(tip, 0.0, 2.0)
    hold(tip, (0.3, 0.2, 0.1), end, 1.0, sigma=0.0003)
    found = tip.found()
    assert found.position == pytest.approx([0.3, 0.2, 0.1], abs=0.0003)
    assert 0.0002 < found.spread_rms < 0.0008 <= found.spread_max
    assert found.samples == pytest.approx(0.5 * RATE + 1, abs=1)


@pytest.mark.parametrize('sigma', [0.0, 0.0001])
def test_identical_samples_are_stationary(sigma: float) -> None:
    tip = Detector()
    hold(tip, (0.0, 0.0, 0.0), 1.7e9, 0.6, sigma=sigma)
    assert tip.found().spread_max <= 6.0 * sigma


def test_refuses_without_samples() -> None:
    with pytest.raises(InputError, match='no probe tip is seen'):
        Detector().found()


def test_refuses_a_moving_tip_and_says_how_far() -> None:
    tip = Detector()
    move(tip, 0.0, 2.0)
    with pytest.raises(InputError,
                       match=r'the tip moves: 25\.0 mm within the last 0\.5 s, 2\.0 mm allowed'):
        tip.found()


def test_refuses_a_short_or_interrupted_dwell() -> None:
    tip = Detector()
    end = hold(tip, (0.0, 0.0, 0.0), 0.0, 0.4)
    with pytest.raises(InputError, match='not been seen'):
        tip.found()
    hold(tip, (0.0, 0.0, 0.0), end + 0.3, 0.4)      # lost for 0.3 s in between
    with pytest.raises(InputError, match='not been seen'):
        tip.found()


def test_ignores_a_source_that_is_silent() -> None:
    tip = Detector()
    hold(tip, (0.0, 0.0, 0.0), 0.0, 1.0, arrival=50.0)
    assert tip.found(now=50.1).samples
    with pytest.raises(InputError, match='no probe tip is seen'):
        tip.found(now=51.0)


def test_returns_the_tip_that_stopped_last() -> None:
    tip = Detector()
    hold(tip, (1.0, 0.0, 0.0), 0.0, 4.0, source=0)       # lies on the table all the time
    end = move(tip, 0.0, 2.0, source=1)
    hold(tip, (0.5, 0.0, 0.0), end, 2.0, source=1)
    assert tip.found().position == pytest.approx([0.5, 0.0, 0.0])


def test_a_moving_tip_does_not_hide_a_stationary_one() -> None:
    tip = Detector()
    hold(tip, (1.0, 0.0, 0.0), 0.0, 2.0, source=0)
    move(tip, 0.0, 2.0, source=1)
    assert tip.found().position == pytest.approx([1.0, 0.0, 0.0])


def test_memory_is_bounded() -> None:
    tip = Detector()
    for i in range(MAX_SAMPLES + 100):
        tip.send(i * 1e-9, (0.0, 0.0, 0.0))
    assert len(tip._sources[0].samples) == MAX_SAMPLES


def test_leaves_out_a_few_outliers() -> None:
    tip = Detector()
    for i in range(81):
        outlier = i in (50, 63, 78)
        tip.send(i / RATE, (0.3 if outlier else 0.1, 0.0, 0.0))
    found = tip.found()
    assert found.position == pytest.approx([0.1, 0.0, 0.0])
    assert found.spread_max == pytest.approx(0.0)
    assert found.samples == 38
    assert found.since == 0.0        # outliers do not restart the dwell


@pytest.mark.parametrize('late', [1, 3])
def test_refuses_a_tip_that_arrives_or_leaves(late: int) -> None:
    for places in ([0.0] * late + [0.1] * (41 - late), [0.1] * (41 - late) + [0.3] * late):
        tip = Detector()
        for i, x in enumerate(places):
            tip.send(i / RATE, (x, 0.0, 0.0))
        with pytest.raises(InputError, match='the tip moves'):
            tip.found()


def test_many_outliers_are_motion() -> None:
    tip = Detector()
    for i in range(81):
        tip.send(i / RATE, (0.3 if i % 6 == 0 else 0.1, 0.0, 0.0))
    with pytest.raises(InputError, match='the tip moves'):
        tip.found()


@pytest.mark.parametrize('speed', [0.02, 0.1, 0.8])
def test_returns_since_when_the_tip_is_stationary(speed: float) -> None:
    tip = Detector()
    for i in range(80):
        tip.send(i / RATE, (speed * i / RATE, 0.0, 0.0), source=7)
    arrived = 80 / RATE
    hold(tip, (speed, 0.0, 0.0), arrived, 1.0, source=7, sigma=0.0001)
    found = tip.found()
    assert found.source == 7
    # not after the tip arrived, or points measured there would be missed; not long before
    assert arrived - 2.0 * 2.0 * CONFIG.radius / speed - 1.5 / RATE <= found.since <= arrived
