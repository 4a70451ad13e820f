# SPDX-License-Identifier: Apache-2.0
"""Detection of clocks that go back: once, not for late packets, and without losing samples."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.tracking.clock import AGREEING, ALONE, BACK, ClockMonitor, StampFilter

RATE = 80.0


def run(stamp_filter: StampFilter[float],
        stamps: list[float]) -> tuple[list[float], list[float], list[float]]:
    """Return each step back, the accepted samples and the outliers."""
    backs, accepted, outliers = [], [], []
    for stamp in stamps:
        check = stamp_filter.add(stamp, stamp)
        backs += [check.went_back] * (check.went_back > 0.0)
        accepted += check.accepted
        outliers += check.outliers
    return backs, accepted, outliers


def ticks(first: float, count: int) -> list[float]:
    return [first + i / RATE for i in range(count)]


def test_accepts_ascending_stamps() -> None:
    stamps = ticks(1000.0, 200) + ticks(1008.0, 200)
    assert run(StampFilter(), stamps) == ([], stamps, [])


def test_reports_a_clock_that_goes_back_once() -> None:
    stamps = ticks(1000.0, 400) + ticks(1000.0, 400)
    backs, accepted, outliers = run(StampFilter(), stamps)
    assert len(backs) == 1 and backs[0] == pytest.approx(399 / RATE)
    assert (accepted, outliers) == (stamps, [])


@pytest.mark.parametrize('late', [1, AGREEING - 1])
def test_a_few_late_packets_are_outliers(late: int) -> None:
    old = ticks(1000.0, late)
    stamps = ticks(1010.0, 100) + old + ticks(1011.25, 100)
    backs, accepted, outliers = run(StampFilter(), stamps)
    assert not backs and outliers == old
    assert accepted == ticks(1010.0, 100) + ticks(1011.25, 100)


def test_late_packets_that_disagree_are_outliers() -> None:
    backs, _, outliers = run(StampFilter(), [*ticks(1010.0, 10), 1003.0, 1002.0, 1001.0, 1000.0,
                                      *ticks(1010.2, 10)])
    assert not backs and outliers == [1003.0, 1002.0, 1001.0, 1000.0]


def test_a_corrupt_stamp_is_a_single_outlier() -> None:
    stamps = [*ticks(1000.0, 50), 5e8, *ticks(1001.0, 50)]
    backs, accepted, outliers = run(StampFilter(), stamps)
    assert not backs and outliers == [5e8]
    assert accepted == ticks(1000.0, 50) + ticks(1001.0, 50)


def test_accepts_a_probe_that_returns_into_view() -> None:
    stamps = ticks(1000.0, 50) + ticks(1100.0, 50)
    assert run(StampFilter(), stamps) == ([], stamps, [])


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 3000.0), max_size=60))
def test_every_sample_is_accepted_an_outlier_or_pending(stamps: list[float]) -> None:
    stamp_filter: StampFilter[float] = StampFilter()
    _, accepted, outliers = run(stamp_filter, stamps)
    assert sorted(accepted + outliers + stamp_filter.flush()) == sorted(stamps)


def loop(monitor: ClockMonitor[tuple[str, float]],
         samples: list[tuple[str, float]]) -> tuple[int, list[tuple[str, float]]]:
    """Return how often the clocks went back, and the samples accepted since."""
    backs, accepted = 0, []
    for topic, stamp in samples:
        check = monitor.add(topic, stamp, (topic, stamp), None)
        if check.went_back:
            backs, accepted = backs + 1, []
        accepted += check.accepted
    return backs, accepted


@settings(deadline=None)
@given(st.permutations(['/a', '/b', '/c']), st.integers(1, 30), st.integers(0, 40))
def test_topics_that_loop_together_go_back_once(order: list[str], every: int, behind: int) -> None:
    """``/c`` is slower than the others, and ``/b`` is behind in its queue by some samples."""
    def once() -> list[tuple[str, float]]:
        return [(topic, 1000.0 + i / RATE) for i in range(400) for topic in order
                if topic != '/c' or i % every == 0]
    samples = once() + once()
    mine = [i for i, (topic, _) in enumerate(samples) if topic == '/b']
    delayed = [samples[i] for i in mine[:len(mine) - behind]]
    for i, sample in zip(mine[behind:], delayed):
        samples[i] = sample
    samples = [sample for i, sample in enumerate(samples) if i not in mine[:behind]]
    backs, accepted = loop(ClockMonitor(), samples)
    assert backs == 1
    for topic in order:
        stamps = [stamp for name, stamp in accepted if name == topic]
        assert stamps == sorted(set(stamps)) and stamps[0] == 1000.0


def test_a_live_topic_beside_a_looped_one_is_accepted_again() -> None:
    samples = [sample for i in range(800)
               for sample in (('/looped', 1000.0 + i % 400 / RATE), ('/live', 9e5 + i / RATE))]
    backs, accepted = loop(ClockMonitor(), samples)
    assert backs == 1
    live = [stamp for topic, stamp in accepted if topic == '/live']
    assert live[0] == pytest.approx(9e5 + 400 / RATE + ALONE + BACK, abs=0.1)
    assert live[-1] == 9e5 + 799 / RATE


@pytest.mark.parametrize('ahead', [0.0, 0.5 * ALONE, 1.5 * ALONE])
def test_local_clock_and_points_go_back_once(ahead: float) -> None:
    """The points are ``ahead`` of the local clock, s."""
    monitor: ClockMonitor[float] = ClockMonitor()
    for stamp in ticks(1000.0, 400):
        monitor.add('/tip', stamp, stamp, stamp)
    noticed, accepted = 0, []
    stamps = ticks(1000.0, 80)
    for stamp in stamps:
        local = stamp - ahead
        if local - 1.0 / RATE < 1000.0 <= local:
            noticed += monitor.local_clock_went_back(1005.0 + ahead)
        check = monitor.add('/tip', stamp, stamp, local + (5.0 + ahead) * (local < 1000.0))
        noticed += check.went_back > 0.0
        accepted += check.accepted
    assert (noticed, accepted) == (1, stamps)


def test_a_second_program_on_a_topic_is_rejected() -> None:
    """The first program has its own clock and is silent for a while."""
    monitor: ClockMonitor[float] = ClockMonitor()
    hidden = range(800, 960)
    backs, first, rejected = 0, [], []
    for i in range(1600):
        for clock, sent in ((5000.0, i not in hidden), (70.0, i > 160)):
            stamp = clock + i / RATE
            if sent:
                check = monitor.add('/tip', stamp, stamp, stamp)
                backs += check.went_back > 0.0
                first += check.accepted
                rejected += check.outliers
    assert backs == 0 and min(first) == 5000.0 and len(first) == 1600 - len(hidden)
    assert len(rejected) > 1430 and max(rejected) < 100.0
    assert '4930.0 s apart' in monitor.problems[0] and 'two programs' in monitor.problems[0]
