# SPDX-License-Identifier: Apache-2.0
"""A clock that goes back is told from a late packet, once, and no sample is lost over it."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.tracking.clock import AGREEING, ALONE, BACK, ClockWatch, Stream

RATE = 80.0


def run(stream: Stream[float], stamps: list[float]) -> tuple[list[float], list[float], list[float]]:
    """Return how far it went back each time, what goes on and what strays."""
    backs, going_on, strays = [], [], []
    for stamp in stamps:
        taken = stream.take(stamp, stamp)
        backs += [taken.back] * (taken.back > 0.0)
        going_on += taken.going_on
        strays += taken.strays
    return backs, going_on, strays


def ticks(first: float, count: int) -> list[float]:
    return [first + i / RATE for i in range(count)]


def test_a_clock_that_goes_on_is_passed_on() -> None:
    stamps = ticks(1000.0, 200) + ticks(1008.0, 200)
    assert run(Stream(), stamps) == ([], stamps, [])


def test_a_clock_that_goes_back_is_told_once_with_all_its_samples() -> None:
    stamps = ticks(1000.0, 400) + ticks(1000.0, 400)
    backs, going_on, strays = run(Stream(), stamps)
    assert len(backs) == 1 and backs[0] == pytest.approx(399 / RATE)
    assert (going_on, strays) == (stamps, [])


@pytest.mark.parametrize('late', [1, AGREEING - 1])
def test_a_few_late_packets_are_no_clock_that_goes_back(late: int) -> None:
    old = ticks(1000.0, late)
    stamps = ticks(1010.0, 100) + old + ticks(1011.25, 100)
    backs, going_on, strays = run(Stream(), stamps)
    assert not backs and strays == old
    assert going_on == ticks(1010.0, 100) + ticks(1011.25, 100)


def test_late_packets_that_do_not_agree_are_no_clock_that_goes_back() -> None:
    backs, _, strays = run(Stream(), [*ticks(1010.0, 10), 1003.0, 1002.0, 1001.0, 1000.0,
                                      *ticks(1010.2, 10)])
    assert not backs and strays == [1003.0, 1002.0, 1001.0, 1000.0]


def test_one_garbled_stamp_in_the_future_costs_nothing_but_itself() -> None:
    stamps = [*ticks(1000.0, 50), 5e8, *ticks(1001.0, 50)]
    backs, going_on, strays = run(Stream(), stamps)
    assert not backs and strays == [5e8]
    assert going_on == ticks(1000.0, 50) + ticks(1001.0, 50)


def test_a_probe_that_is_back_in_view_after_a_while_loses_nothing() -> None:
    stamps = ticks(1000.0, 50) + ticks(1100.0, 50)
    assert run(Stream(), stamps) == ([], stamps, [])


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 3000.0), max_size=60))
def test_every_sample_goes_on_strays_or_is_held(stamps: list[float]) -> None:
    stream: Stream[float] = Stream()
    _, going_on, strays = run(stream, stamps)
    assert sorted(going_on + strays + stream.end()) == sorted(stamps)


def loop(watch: ClockWatch[tuple[str, float]],
         samples: list[tuple[str, float]]) -> tuple[int, list[tuple[str, float]]]:
    """Return how often the clocks went back, and what goes on since."""
    backs, going_on = 0, []
    for source, stamp in samples:
        taken = watch.take(source, stamp, (source, stamp), None)
        if taken.back:
            backs, going_on = backs + 1, []
        going_on += taken.going_on
    return backs, going_on


@settings(deadline=None)
@given(st.permutations(['/a', '/b', '/c']), st.integers(1, 30), st.integers(0, 40))
def test_topics_that_loop_together_go_back_once(order: list[str], every: int, behind: int) -> None:
    """``/c`` is slower than the others, and ``/b`` is behind in its queue by some samples."""
    def once() -> list[tuple[str, float]]:
        return [(source, 1000.0 + i / RATE) for i in range(400) for source in order
                if source != '/c' or i % every == 0]
    samples = once() + once()
    mine = [i for i, (source, _) in enumerate(samples) if source == '/b']
    delayed = [samples[i] for i in mine[:len(mine) - behind]]
    for i, sample in zip(mine[behind:], delayed):
        samples[i] = sample
    samples = [sample for i, sample in enumerate(samples) if i not in mine[:behind]]
    backs, going_on = loop(ClockWatch(), samples)
    assert backs == 1
    for source in order:
        stamps = [stamp for name, stamp in going_on if name == source]
        assert stamps == sorted(set(stamps)) and stamps[0] == 1000.0


def test_a_live_probe_beside_a_looped_one_is_heard_again() -> None:
    samples = [sample for i in range(800)
               for sample in (('/looped', 1000.0 + i % 400 / RATE), ('/live', 9e5 + i / RATE))]
    backs, going_on = loop(ClockWatch(), samples)
    assert backs == 1
    live = [stamp for source, stamp in going_on if source == '/live']
    assert live[0] == pytest.approx(9e5 + 400 / RATE + ALONE + BACK, abs=0.1)
    assert live[-1] == 9e5 + 799 / RATE


@pytest.mark.parametrize('ahead', [0.0, 0.5 * ALONE, 1.5 * ALONE])
def test_our_own_clock_and_the_points_go_back_once(ahead: float) -> None:
    """The points are ``ahead`` by so much, in s."""
    watch: ClockWatch[float] = ClockWatch()
    for stamp in ticks(1000.0, 400):
        watch.take('/tip', stamp, stamp, stamp)
    noticed, going_on = 0, []
    stamps = ticks(1000.0, 80)
    for stamp in stamps:
        ours = stamp - ahead
        if ours - 1.0 / RATE < 1000.0 <= ours:
            noticed += watch.our_clock_went_back(1005.0 + ahead)
        taken = watch.take('/tip', stamp, stamp, ours + (5.0 + ahead) * (ours < 1000.0))
        noticed += taken.back > 0.0
        going_on += taken.going_on
    assert (noticed, going_on) == (1, stamps)


def test_two_programs_on_one_topic_cost_nothing_that_was_heard() -> None:
    """One goes first, by its own clock; now and then it is not heard for a while."""
    watch: ClockWatch[float] = ClockWatch()
    hidden = range(800, 960)
    backs, first, refused = 0, [], []
    for i in range(1600):
        for clock, heard in ((5000.0, i not in hidden), (70.0, i > 160)):
            stamp = clock + i / RATE
            if heard:
                taken = watch.take('/tip', stamp, stamp, stamp)
                backs += taken.back > 0.0
                first += taken.going_on
                refused += taken.strays
    assert backs == 0 and min(first) == 5000.0 and len(first) == 1600 - len(hidden)
    assert len(refused) > 1430 and max(refused) < 100.0
    assert '4930.0 s apart' in watch.trouble[0] and 'two programs' in watch.trouble[0]
