# SPDX-License-Identifier: Apache-2.0
"""Every gate, and the laws that hold whatever is sent."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dragging import RATE, collection, drag, path, two_strokes, undone
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.result import InputError
from gsdf_registration.common.samples import AGREEING, Rejection
from gsdf_registration.session.collection import FIRST_ROOM


def test_sound_points_are_kept_as_they_are() -> None:
    c = collection()
    assert drag(c, 100) == [None] * 100
    points = c.arrays()
    assert np.array_equal(points.positions, [path(i) for i in range(100)])
    assert np.array_equal(points.stamps, np.arange(100) / RATE)
    assert set(points.strokes) == {1} and set(points.sources) == {0}
    assert (c.received, len(c), c.strokes, c.frame_id) == (100, 100, 1, 'cam')


@pytest.mark.parametrize('position', [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0),
                                      (0.0, 0.0, -math.inf), (-3.697314e28, 0.0, 0.0)])
def test_what_is_no_position_is_refused(position: tuple[float, float, float]) -> None:
    c = collection()
    assert c.add(0.0, position, 'cam') is Rejection.NOT_FINITE
    assert c.frame_id is None
    assert drag(c, 3) == [None] * 3


def test_a_stamp_that_is_no_time_is_refused() -> None:
    c = collection()
    assert c.add(math.nan, path(0), 'cam') is Rejection.NOT_FINITE
    assert c.add(math.inf, path(0), 'cam') is Rejection.NOT_FINITE
    assert drag(c, 3) == [None] * 3


def test_the_first_point_decides_on_the_frame_unless_it_is_given() -> None:
    c = collection()
    drag(c, 1)
    assert c.add(1.0, path(1), 'other') is Rejection.WRONG_FRAME
    c = collection(frame_id='array')
    assert c.add(1.0, path(1), 'cam') is Rejection.WRONG_FRAME
    assert c.add(1.0, path(1), 'array') is None


def test_stamps_of_a_source_must_rise() -> None:
    c = collection()
    drag(c, 10)
    assert c.add(9 / RATE, path(10), 'cam') is Rejection.NOT_MONOTONIC
    assert c.add(8 / RATE, path(10), 'cam') is Rejection.NOT_MONOTONIC
    assert c.add(8 / RATE, path(10), 'cam', source=1) is None      # another source has its own time
    assert c.add(10 / RATE, path(10), 'cam') is None


def test_late_points_are_stale_when_the_source_has_our_clock() -> None:
    c = collection(max_age=0.5)
    assert c.add(100.0, path(0), 'cam', arrival=100.01) is None
    assert c.add(100.1, path(1), 'cam', arrival=100.7) is Rejection.STALE
    assert c.add(100.6, path(2), 'cam', arrival=100.7) is None


def test_a_recording_played_slower_than_it_was_made_is_never_stale() -> None:
    c = collection(max_age=0.5)
    for i in range(100):
        assert c.add(i / RATE, path(i), 'cam', arrival=1e9 + 10.0 * i) is None


def test_the_same_position_again_is_a_duplicate() -> None:
    c = collection()
    drag(c, 5)
    assert c.add(5 / RATE, path(4), 'cam') is Rejection.DUPLICATE
    assert c.add(6 / RATE, path(4), 'cam', source=1) is None
    near = collection(min_distance=0.002)
    assert near.add(0.0, (0.0, 0.0, 0.0), 'cam') is None
    assert near.add(0.1, (0.0, 0.0019, 0.0), 'cam') is Rejection.DUPLICATE
    assert near.add(0.2, (0.0, 0.0021, 0.0), 'cam') is None


def test_poor_quality_is_refused_and_unknown_quality_is_not() -> None:
    c = collection(quality=0.001)
    assert c.add(0.0, path(0), 'cam', quality=0.0009) is None
    assert c.add(0.1, path(1), 'cam', quality=0.0011) is Rejection.POOR_QUALITY
    assert c.add(0.2, path(2), 'cam', quality=math.nan) is None
    assert collection(quality=0.0).add(0.0, path(0), 'cam', quality=1.0) is None


def test_nothing_is_kept_while_not_collecting() -> None:
    c = collection()
    drag(c, 5)
    c.end_stroke()
    assert c.add(6 / RATE, path(6), 'cam') is Rejection.NOT_COLLECTING
    # a fault of the sample is shown anyway
    assert c.add(7 / RATE, (math.nan,) * 3, 'cam') is Rejection.NOT_FINITE
    assert len(c) == 5


def test_a_full_collection_says_so_and_forgets_nothing() -> None:
    c = collection(max_points=50)
    assert drag(c, 60) == [None] * 50 + [Rejection.FULL] * 10
    assert np.array_equal(c.arrays().positions, [path(i) for i in range(50)])
    assert undone(c) == 50
    assert c.add(61 / RATE, path(61), 'cam') is None


def test_room_is_bounded_and_doubled() -> None:
    c = collection(max_points=FIRST_ROOM * 3)
    drag(c, FIRST_ROOM * 3 + 100)
    assert len(c) == FIRST_ROOM * 3
    assert len(c._points.stamps) <= FIRST_ROOM * 4


@pytest.mark.parametrize('wild_at', [0, 1, 20, 39])
def test_one_wild_point_does_not_lock_out_the_others(wild_at: int) -> None:
    c = collection()
    rejected = []
    for i in range(40):
        point = (5.0, 5.0, 5.0) if i == wild_at else path(i)
        rejected.append(c.add(i / RATE, point, 'cam'))
    if wild_at:     # it is known to be wild, and nothing else suffers
        assert [i for i, r in enumerate(rejected) if r] == [wild_at]
        assert rejected[wild_at] is Rejection.TOO_FAST
    else:           # nobody could know: it costs as many points as must agree
        assert [i for i, r in enumerate(rejected) if r] == list(range(1, AGREEING))


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 199), st.floats(0.5, 3.0), st.sampled_from([-1.0, 1.0])),
                max_size=20))
def test_scattered_wild_points_cost_few_good_ones(wild: list[tuple[int, float, float]]) -> None:
    c = collection(max_gap=0.5)
    # no two near each other
    wild_at = {index: side * (offset + index) for index, offset, side in wild}
    kept = 0
    for i in range(200):
        x, y, z = path(i)
        rejection = c.add(i / RATE, (x, y + wild_at.get(i, 0.0), z), 'cam')
        kept += rejection is None and i not in wild_at
    assert kept >= 200 - len(wild_at) - (AGREEING - 1) * (1 + len(wild_at))


def test_a_tip_that_comes_back_elsewhere_is_taken_up_again_as_another_stroke() -> None:
    c = collection(max_gap=0.5)
    drag(c, 10)
    far = [(x, y + 0.4, z) for x, y, z in map(path, range(30))]
    soon = [c.add((12 + i) / RATE, far[i], 'cam') for i in range(5)]
    assert soon == [Rejection.TOO_FAST] * (AGREEING - 1) + [None] * (6 - AGREEING)
    assert c.strokes == 2
    late = c.add(60.0, path(0), 'cam')      # after a silence a point is not judged by its speed
    assert late is None and c.strokes == 3


def test_a_long_run_of_jumps_that_agree_with_nothing_stays_out() -> None:
    c = collection(max_gap=10.0)
    drag(c, 1)
    jumps = [c.add((i + 1) / RATE, (1.0 + i % 2, float(i), 0.0), 'cam') for i in range(100)]
    assert set(jumps) == {Rejection.TOO_FAST}


def test_strokes_lie_between_start_and_end_and_are_split_by_silence() -> None:
    c = collection(max_gap=0.5)
    drag(c, 10)
    drag(c, 10, first=100)      # more than a second later
    c.end_stroke()
    drag(c, 10, first=110)
    c.start_stroke()
    drag(c, 10, first=120)
    assert c.arrays().strokes.tolist() == [1] * 10 + [2] * 10 + [3] * 10


def test_a_resting_tip_is_no_silence() -> None:
    c = collection(max_gap=0.5)
    drag(c, 1)
    for i in range(1, 200):
        assert c.add(i / RATE, path(0), 'cam') is Rejection.DUPLICATE
    assert c.add(200 / RATE, path(1), 'cam') is None
    assert c.strokes == 1


def test_undo_drops_the_stroke_begun_last() -> None:
    c = two_strokes(10, 7)
    assert undone(c) == 7
    assert np.array_equal(c.arrays().positions, [path(i) for i in range(10)])
    drag(c, 5, first=20)        # the one that goes on after it is a new one
    assert c.strokes == 2
    assert [undone(c), undone(c), c.undo()] == [5, 10, None]
    assert (len(c), c.strokes) == (0, 0)
    assert c.received == 22 == c.undone


def test_sources_have_strokes_of_their_own() -> None:
    c = collection()
    for i in range(10):
        drag(c, 1, first=i, source=0)
        drag(c, 1, first=i, source=1)
    points = c.arrays()
    assert points.sources.tolist() == [0, 1] * 10
    assert points.strokes.tolist() == [1, 2] * 10
    assert undone(c) == 10
    assert c.arrays().sources.tolist() == [0] * 10


def test_clear_forgets_frame_stamps_and_counts() -> None:
    c = collection()
    drag(c, 10, first=100)
    c.add(0.0, path(0), 'other')
    c.clear()
    assert c.collecting and c.received == 0 and not any(c.counts.values())
    assert c.add(0.0, path(0), 'other') is None


def test_refill_takes_up_where_it_was_left() -> None:
    c = collection()
    drag(c, 10)
    c.start_stroke()
    drag(c, 10, first=10)
    c.add(0.0, path(0), 'cam')
    other = collection()
    other.refill(c.arrays(), c.frame_id, c.counts)
    assert all(np.array_equal(a, b) for a, b in zip(other.arrays(), c.arrays()))
    assert (other.received, other.frame_id, other.strokes) == (21, 'cam', 2)
    drag(other, 2000, first=20)
    assert len(other) == 2020 and undone(other) == 2000
    assert np.array_equal(other.arrays().positions, c.arrays().positions)


def test_refill_refuses_what_does_not_fit_and_changes_nothing() -> None:
    c = collection()
    drag(c, 200)
    for other in (collection(max_points=100), collection(frame_id='array')):
        with pytest.raises(InputError):
            other.refill(c.arrays(), c.frame_id, c.counts)
        assert len(other) == 0


def test_what_a_resting_tip_delivered_is_taken_out_and_held_back_until_it_leaves() -> None:
    c = collection()
    drag(c, 40)
    drag(c, 40, first=40, source=1)
    place = path(30)
    assert c.withdraw(0, 30 / RATE, place, 0.004) == 10
    assert len(c) == 70 and c.counts['touched'] == 10
    points = c.arrays()
    assert points.stamps[points.sources == 0].max() < 30 / RATE
    assert (points.sources == 1).sum() == 40      # the other probe is not concerned
    later = [c.add((40 + i) / RATE, (place[0] + 0.0002 * i, *place[1:]), 'cam') for i in range(30)]
    assert later == [Rejection.TOUCHED] * 20 + [None] * 10 or later == (
        [Rejection.TOUCHED] * 21 + [None] * 9)
    assert c.add(1.0, place, 'cam') is None     # it may come back as any other point
    assert c.received == len(c) + c.undone + sum(c.counts.values())
    assert c.strokes == 3


def test_a_stroke_that_was_all_rest_is_gone() -> None:
    c = two_strokes(10, 10)
    assert c.withdraw(0, 10 / RATE, path(15), 0.1) == 10
    assert c.strokes == 1 and undone(c) == 10 and c.undo() is None


def test_serials_tell_which_points_are_still_there() -> None:
    c = collection()
    drag(c, 10)
    c.start_stroke()
    drag(c, 5, first=10)
    before = c.serials()
    c.undo()
    drag(c, 5, first=20)
    after = c.serials()
    assert (np.diff(after) > 0).all()
    assert np.isin(after, before).tolist() == [True] * 10 + [False] * 5
    c.clear()
    drag(c, 5)
    assert not np.isin(c.serials(), after).any()


numbers = st.floats(-2.0, 2.0) | st.sampled_from([math.nan, math.inf, -1e30])
samples = st.tuples(st.floats(0.0, 10.0) | st.just(math.nan), st.tuples(numbers, numbers, numbers),
                    st.sampled_from(['cam', 'cam', 'cam', 'other']), st.integers(0, 2),
                    st.none() | st.floats(0.0, 10.0), st.none() | st.floats(0.0, 0.002))


@settings(deadline=None, max_examples=100)
@given(st.lists(samples | st.sampled_from(['start', 'end', 'undo', 'touch']), max_size=60))
def test_every_point_received_is_kept_undone_or_counted(events: list) -> None:
    c = collection(max_points=20)
    for event in events:
        if isinstance(event, str):
            {'start': c.start_stroke, 'end': c.end_stroke, 'undo': c.undo,
             'touch': lambda: c.withdraw(0, 5.0, (0.0, 0.0, 0.0), 1.0)}[event]()
        else:
            c.add(*event)
    assert c.received == len(c) + c.undone + sum(c.counts.values())
    points = c.arrays()
    assert len(c) <= 20 and np.isfinite(points.positions).all()
    assert c.strokes == len(set(points.strokes.tolist()))
    for source in range(3):
        assert (np.diff(points.stamps[points.sources == source]) > 0.0).all()


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(0, 2), min_size=1, max_size=60), st.randoms())
def test_how_sources_interleave_does_not_matter(order: list[int], random) -> None:
    def outcome(turns: list[int]) -> tuple[dict[str, int], list]:
        c = collection(frame_id='cam', max_gap=10.0)
        at = dict.fromkeys(range(3), 0)
        for source in turns:
            i = at[source] = at[source] + 1
            y = 1.0 if i % 7 == 3 else 0.0      # a wild point now and then
            c.add(i / RATE if i % 5 else 0.0, (path(i)[0], y, float(source)), 'cam', source)
        points = c.arrays()
        return c.counts, [
            points.positions[points.sources == source].tolist() for source in range(3)
        ]

    shuffled = list(order)
    random.shuffle(shuffled)
    assert outcome(order) == outcome(shuffled)
