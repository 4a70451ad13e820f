# SPDX-License-Identifier: Apache-2.0
"""Which samples are accepted, which strokes they belong to, and the invariants of the counts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from collection_fixtures import RATE, collection, drag, path, two_strokes, undone
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.result import InputError
from gsdf_registration.common.samples import AGREEING, Rejection
from gsdf_registration.session.collection import INITIAL_CAPACITY


def test_adds_valid_points_unchanged() -> None:
    c = collection()
    assert drag(c, 100) == [None] * 100
    points = c.points()
    assert np.array_equal(points.positions, [path(i) for i in range(100)])
    assert np.array_equal(points.stamps, np.arange(100) / RATE)
    assert set(points.strokes) == {1} and set(points.sources) == {0}
    assert (c.received, len(c), c.strokes, c.frame_id) == (100, 100, 1, 'cam')


@pytest.mark.parametrize('position', [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0),
                                      (0.0, 0.0, -math.inf), (-3.697314e28, 0.0, 0.0)])
def test_rejects_positions_that_are_not_finite(position: tuple[float, float, float]) -> None:
    c = collection()
    assert c.add_point(0.0, position) is Rejection.NOT_FINITE
    assert c.frame_id is None
    assert drag(c, 3) == [None] * 3


def test_rejects_stamps_that_are_not_finite() -> None:
    c = collection()
    assert c.add_point(math.nan, path(0)) is Rejection.NOT_FINITE
    assert c.add_point(math.inf, path(0)) is Rejection.NOT_FINITE
    assert drag(c, 3) == [None] * 3


def test_rejects_points_in_another_frame() -> None:
    c = collection()
    drag(c, 1)
    assert c.add_point(1.0, path(1), 'other') is Rejection.WRONG_FRAME
    c = collection(frame_id='array')
    assert c.add_point(1.0, path(1)) is Rejection.WRONG_FRAME
    assert c.add_point(1.0, path(1), 'array') is None


def test_rejects_stamps_that_do_not_ascend() -> None:
    c = collection()
    drag(c, 10)
    assert c.add_point(9 / RATE, path(10)) is Rejection.NOT_MONOTONIC
    assert c.add_point(8 / RATE, path(10)) is Rejection.NOT_MONOTONIC
    assert c.add_point(8 / RATE, path(10), source=1) is None    # stamps are compared per source
    assert c.add_point(10 / RATE, path(10)) is None


def test_rejects_stale_points_of_a_source_with_the_local_clock() -> None:
    c = collection(max_age=0.5)
    assert c.add_point(100.0, path(0), 'cam', arrival=100.01) is None
    assert c.add_point(100.1, path(1), 'cam', arrival=100.7) is Rejection.STALE
    assert c.add_point(100.6, path(2), 'cam', arrival=100.7) is None


def test_a_slow_playback_is_never_stale() -> None:
    c = collection(max_age=0.5)
    for i in range(100):
        assert c.add_point(i / RATE, path(i), 'cam', arrival=1e9 + 10.0 * i) is None


def test_rejects_duplicates() -> None:
    c = collection()
    drag(c, 5)
    assert c.add_point(5 / RATE, path(4)) is Rejection.DUPLICATE
    assert c.add_point(6 / RATE, path(4), 'cam', source=1) is None
    near = collection(min_distance=0.002)
    assert near.add_point(0.0, (0.0, 0.0, 0.0)) is None
    assert near.add_point(0.1, (0.0, 0.0019, 0.0)) is Rejection.DUPLICATE
    assert near.add_point(0.2, (0.0, 0.0021, 0.0)) is None


def test_rejects_poor_quality_but_not_unknown_quality() -> None:
    c = collection(quality=0.001)
    assert c.add_point(0.0, path(0), 'cam', quality=0.0009) is None
    assert c.add_point(0.1, path(1), 'cam', quality=0.0011) is Rejection.POOR_QUALITY
    assert c.add_point(0.2, path(2), 'cam', quality=math.nan) is None
    assert collection(quality=0.0).add_point(0.0, path(0), quality=1.0) is None


def test_rejects_points_while_not_collecting() -> None:
    c = collection()
    drag(c, 5)
    c.end_stroke()
    assert c.add_point(6 / RATE, path(6)) is Rejection.NOT_COLLECTING
    # invalid samples are counted as such anyway
    assert c.add_point(7 / RATE, (math.nan,) * 3) is Rejection.NOT_FINITE
    assert len(c) == 5


def test_a_full_collection_rejects_points_and_keeps_the_others() -> None:
    c = collection(max_points=50)
    assert drag(c, 60) == [None] * 50 + [Rejection.FULL] * 10
    assert np.array_equal(c.points().positions, [path(i) for i in range(50)])
    assert undone(c) == 50
    assert c.add_point(61 / RATE, path(61)) is None


def test_capacity_is_doubled_and_bounded() -> None:
    c = collection(max_points=INITIAL_CAPACITY * 3)
    drag(c, INITIAL_CAPACITY * 3 + 100)
    assert len(c) == INITIAL_CAPACITY * 3
    assert len(c._points.stamps) <= INITIAL_CAPACITY * 4


@pytest.mark.parametrize('outlier_at', [0, 1, 20, 39])
def test_one_outlier_does_not_block_the_points_after_it(outlier_at: int) -> None:
    c = collection()
    rejected = []
    for i in range(40):
        point = (5.0, 5.0, 5.0) if i == outlier_at else path(i)
        rejected.append(c.add_point(i / RATE, point))
    if outlier_at:     # only the outlier is rejected
        assert [i for i, r in enumerate(rejected) if r] == [outlier_at]
        assert rejected[outlier_at] is Rejection.TOO_FAST
    else:           # the first point is the outlier: the next ones must agree first
        assert [i for i, r in enumerate(rejected) if r] == list(range(1, AGREEING))


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 199), st.floats(0.5, 3.0), st.sampled_from([-1.0, 1.0])),
                max_size=20))
def test_scattered_outliers_cost_few_good_points(outliers: list[tuple[int, float, float]]) -> None:
    c = collection(max_gap=0.5)
    # no two outliers are near each other
    outlier_at = {index: side * (offset + index) for index, offset, side in outliers}
    kept = 0
    for i in range(200):
        x, y, z = path(i)
        rejection = c.add_point(i / RATE, (x, y + outlier_at.get(i, 0.0), z))
        kept += rejection is None and i not in outlier_at
    assert kept >= 200 - len(outlier_at) - (AGREEING - 1) * (1 + len(outlier_at))


def test_a_jump_is_accepted_as_a_new_stroke_when_points_agree() -> None:
    c = collection(max_gap=0.5)
    drag(c, 10)
    far = [(x, y + 0.4, z) for x, y, z in map(path, range(30))]
    soon = [c.add_point((12 + i) / RATE, far[i]) for i in range(5)]
    assert soon == [Rejection.TOO_FAST] * (AGREEING - 1) + [None] * (6 - AGREEING)
    assert c.strokes == 2
    late = c.add_point(60.0, path(0))      # after a silence the speed is not checked
    assert late is None and c.strokes == 3


def test_rejects_jumps_that_never_agree() -> None:
    c = collection(max_gap=10.0)
    drag(c, 1)
    jumps = [c.add_point((i + 1) / RATE, (1.0 + i % 2, float(i), 0.0)) for i in range(100)]
    assert set(jumps) == {Rejection.TOO_FAST}


def test_calls_and_silence_separate_strokes() -> None:
    c = collection(max_gap=0.5)
    drag(c, 10)
    drag(c, 10, first=100)      # more than a second later
    c.end_stroke()
    drag(c, 10, first=110)
    c.start_stroke()
    drag(c, 10, first=120)
    assert c.points().strokes.tolist() == [1] * 10 + [2] * 10 + [3] * 10


def test_a_stationary_tip_does_not_split_the_stroke() -> None:
    c = collection(max_gap=0.5)
    drag(c, 1)
    for i in range(1, 200):
        assert c.add_point(i / RATE, path(0)) is Rejection.DUPLICATE
    assert c.add_point(200 / RATE, path(1)) is None
    assert c.strokes == 1


def test_undo_drops_the_last_stroke() -> None:
    c = two_strokes(10, 7)
    assert undone(c) == 7
    assert np.array_equal(c.points().positions, [path(i) for i in range(10)])
    drag(c, 5, first=20)        # what follows is a new stroke
    assert c.strokes == 2
    assert [undone(c), undone(c), c.undo()] == [5, 10, None]
    assert (len(c), c.strokes) == (0, 0)
    assert c.received == 22 == c.counts['undone']


def test_each_source_has_its_own_strokes() -> None:
    c = collection()
    for i in range(10):
        drag(c, 1, first=i, source=0)
        drag(c, 1, first=i, source=1)
    points = c.points()
    assert points.sources.tolist() == [0, 1] * 10
    assert points.strokes.tolist() == [1, 2] * 10
    assert undone(c) == 10
    assert c.points().sources.tolist() == [0] * 10


def test_clear_resets_frame_stamps_and_counts() -> None:
    c = collection()
    drag(c, 10, first=100)
    c.add_point(0.0, path(0), 'other')
    c.clear()
    assert c.collecting and c.received == 0 and not any(c.counts.values())
    assert c.add_point(0.0, path(0), 'other') is None


def test_restore_continues_where_the_session_was_saved() -> None:
    c = collection()
    drag(c, 10)
    c.start_stroke()
    drag(c, 10, first=10)
    c.add_point(0.0, path(0))
    other = collection()
    other.restore_points(c.points(), c.frame_id, c.counts)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(other.points(), c.points()))
    assert (other.received, other.frame_id, other.strokes) == (21, 'cam', 2)
    drag(other, 2000, first=20)
    assert len(other) == 2020 and undone(other) == 2000
    assert np.array_equal(other.points().positions, c.points().positions)


def test_restore_rejects_too_many_points_and_another_frame() -> None:
    c = collection()
    drag(c, 200)
    for other in (collection(max_points=100), collection(frame_id='array')):
        with pytest.raises(InputError):
            other.restore_points(c.points(), c.frame_id, c.counts)
        assert len(other) == 0


def test_withdraw_drops_points_and_rejects_more_until_the_tip_leaves() -> None:
    c = collection()
    drag(c, 40)
    drag(c, 40, first=40, source=1)
    place = path(30)
    assert c.withdraw(0, 30 / RATE, place, 0.004) == 10
    assert len(c) == 70 and c.counts['touched'] == 10
    points = c.points()
    assert points.stamps[points.sources == 0].max() < 30 / RATE
    assert (points.sources == 1).sum() == 40      # the other probe is not affected
    later = [c.add_point((40 + i) / RATE, (place[0] + 0.0002 * i, *place[1:])) for i in range(30)]
    assert later == [Rejection.TOUCHED] * 20 + [None] * 10 or later == (
        [Rejection.TOUCHED] * 21 + [None] * 9)
    assert c.add_point(1.0, place) is None     # later the tip may return there
    assert c.received == len(c) + sum(c.counts.values())
    assert c.strokes == 3


def test_withdraw_removes_empty_strokes() -> None:
    c = two_strokes(10, 10)
    assert c.withdraw(0, 10 / RATE, path(15), 0.1) == 10
    assert c.strokes == 1 and undone(c) == 10 and c.undo() is None


def test_serials_identify_the_remaining_points() -> None:
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
def test_every_point_received_is_added_undone_or_counted(events: list) -> None:
    c = collection(max_points=20)
    for event in events:
        if isinstance(event, str):
            {'start': c.start_stroke, 'end': c.end_stroke, 'undo': c.undo,
             'touch': lambda: c.withdraw(0, 5.0, (0.0, 0.0, 0.0), 1.0)}[event]()
        else:
            stamp, position, frame_id, source, arrival, quality = event
            c.add_point(stamp, position, frame_id, source, arrival=arrival, quality=quality)
    assert c.received == len(c) + sum(c.counts.values())
    points = c.points()
    assert len(c) <= 20 and np.isfinite(points.positions).all()
    assert c.strokes == len(set(points.strokes.tolist()))
    for source in range(3):
        assert (np.diff(points.stamps[points.sources == source]) > 0.0).all()


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(0, 2), min_size=1, max_size=60), st.randoms())
def test_the_order_of_the_sources_does_not_matter(order: list[int], random) -> None:
    def outcome(turns: list[int]) -> tuple[dict[str, int], list]:
        c = collection(frame_id='cam', max_gap=10.0)
        at = dict.fromkeys(range(3), 0)
        for source in turns:
            i = at[source] = at[source] + 1
            y = 1.0 if i % 7 == 3 else 0.0      # one outlier in seven points
            c.add_point(i / RATE if i % 5 else 0.0, (path(i)[0], y, float(source)), 'cam', source)
        points = c.points()
        return c.counts, [
            points.positions[points.sources == source].tolist() for source in range(3)
        ]

    shuffled = list(order)
    random.shuffle(shuffled)
    assert outcome(order) == outcome(shuffled)


def test_arrays_are_views_that_later_changes_do_not_affect() -> None:
    c = two_strokes(10, 10)
    before, serials = c.points(), c.serials()
    copy, count = before.positions.copy(), len(c)
    assert np.shares_memory(before.positions, c.points(5).positions)
    with pytest.raises(ValueError, match='read-only'):
        before.positions[0] = 0.0
    undone(c)
    drag(c, 2 * INITIAL_CAPACITY, first=100)
    c.clear()
    drag(c, 20)
    assert np.array_equal(before.positions, copy) and len(serials) == count


def test_the_stroke_number_of_a_recording_starts_strokes() -> None:
    c = collection()
    for i, number in enumerate([7, 7, 3, 3, 7]):
        assert c.add_point(i / RATE, path(i), stroke=number) is None
    assert c.points().strokes.tolist() == [1, 1, 2, 2, 3]
