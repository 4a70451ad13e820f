# SPDX-License-Identifier: Apache-2.0
"""Test recordings and how they are merged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.result import InputError
from msg_adapters.recording import RecordedTransform, Recording, merge


def recording(stamps, **known):
    stamps = np.asarray(stamps, float)
    return Recording(np.column_stack([stamps] * 3), stamps=stamps, **known)


def test_one_frame_id_applies_to_all_points():
    points = Recording([[1, 2, 3], [4, 5, 6]], frame_ids='tracker')
    assert len(points) == 2
    assert points.frame_ids == ['tracker', 'tracker']
    assert points.positions.dtype == np.float64 and points.sources.tolist() == [0, 0]
    assert len(Recording([])) == 0


@pytest.mark.parametrize('wrong, word', [
    ({'positions': [[1, 2]]}, 'positions'),
    ({'stamps': [1.0]}, 'stamps'),
    ({'stamps': [1.0, np.nan]}, 'stamps'),
    ({'frame_ids': ['a']}, 'frame_ids'),
    ({'sources': [0, 1]}, 'sources'),
    ({'sources': [0, -1]}, 'sources'),
    ({'quality': [[1.0], [2.0]]}, 'quality'),
    ({'strokes': [1, 2, 3]}, 'strokes'),
])
def test_rejects_fields_of_the_wrong_shape(wrong, word):
    with pytest.raises(ValueError, match=word):
        Recording(**{'positions': np.zeros((2, 3)), **wrong})


def test_merge_orders_points_by_stamp_with_their_fields():
    a = recording([1.0, 3.0, 5.0], frame_ids='a', source_names=['/a'], quality=[1e-4, 2e-4, 3e-4],
                  dropped={'x': 1})
    b = recording([2.0, 3.0, 4.0], frame_ids='b', source_names=['/b'], strokes=[7, 7, 8],
                  dropped={'x': 2, 'y': 1}, notes=('odd',))
    both = merge([a, b])
    assert both.stamps.tolist() == [1, 2, 3, 3, 4, 5]
    assert both.positions[:, 0].tolist() == both.stamps.tolist()
    # points with equal stamps keep the order of the recordings
    assert both.frame_ids == ['a', 'b', 'a', 'b', 'b', 'a']
    assert [both.source_names[i] for i in both.sources] == ['/a', '/b', '/a', '/b', '/b', '/a']
    assert np.isnan(both.quality).tolist() == [False, True, False, True, True, False]
    strokes = both.strokes.tolist()
    assert strokes[0] == strokes[2] == strokes[5] and strokes[1] == strokes[3]
    assert len({strokes[0], strokes[1], strokes[4]}) == 3
    assert both.dropped == {'x': 3, 'y': 1} and both.notes == ('odd',)


def test_merge_keeps_a_transform_after_the_point_that_it_followed():
    def transforms(*after):
        return [RecordedTransform(n, float(n), np.eye(4), 'tracker', child=f'{n}') for n in after]
    a = recording([1.0, 3.0, 5.0], transforms=transforms(0, 2, 3))
    b = recording([2.0, 4.0], transforms=transforms(0, 1, 1))
    both = merge([a, b])
    assert [(each.after, each.child) for each in both.transforms] == [
        (0, '0'), (0, '0'), (2, '1'), (2, '1'), (3, '2'), (5, '3')]


def test_merge_joins_sources_with_the_same_name():
    both = merge([recording([1], source_names=['/a']),
                  recording([0], source_names=['/b', '/a'], sources=[1])])
    assert both.source_names == ['/a', '/b'] and both.sources.tolist() == [0, 0]


def test_merge_keeps_the_order_of_a_clock_that_goes_back():
    both = merge(
        [recording([1, 5, 2, 6], source_names=['/a']),
         recording([3, 5.5], source_names=['/b'])])
    assert both.stamps[both.sources == 0].tolist() == [1, 5, 2, 6]
    assert both.stamps.tolist() == [1, 3, 5, 2, 5.5, 6]


def test_merge_concatenates_recordings_without_stamps():
    both = merge([Recording([[1, 0, 0]]), Recording([[0, 0, 0]])])
    assert both.stamps is None and both.positions[:, 0].tolist() == [1, 0]


def test_merge_rejects_invalid_input():
    with pytest.raises(InputError, match='ordered'):
        merge([Recording([[1, 0, 0]]), recording([1])])
    with pytest.raises(InputError, match='no recordings'):
        merge([])


@settings(deadline=None, max_examples=50)
@given(st.lists(st.lists(st.floats(0, 1e6), max_size=8), min_size=1, max_size=4))
def test_merge_keeps_all_points_and_the_order_of_each_recording(stamps):
    parts = [recording(times, source_names=[str(i)]) for i, times in enumerate(stamps)]
    both = merge(parts)
    for i, times in enumerate(stamps):
        assert both.stamps[both.sources == both.source_names.index(str(i))].tolist() == times
    if all(times == sorted(times) for times in stamps):
        assert both.stamps.tolist() == sorted(sum(stamps, []))
