# SPDX-License-Identifier: Apache-2.0
"""Which results of two runs over an archive differ."""

from __future__ import annotations

from typing import Any

import pytest

from gsdf_registration.registration.run_comparison import KEPT, compare_runs

PLACES = '[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]'


def row(bag: str, x: float | None = 0.0, **more: Any) -> dict[str, Any]:
    """Return a row: registered at ``x``, or refused without it."""
    found = {**dict.fromkeys(KEPT, ''), 'bag': bag, 'bag_sha256': bag.rpartition('/')[2],
             'reason': 'converged' if x is not None else 'ambiguous', 'version': '1',
             'places_m': PLACES, **dict.fromkeys(('qx', 'qy', 'qz'), 0.0), 'qw': 1.0,
             **dict.fromkeys(('x_m', 'y_m', 'z_m'), 0.0 if x is not None else None)}
    return {**found, 'x_m': x, **more}


def test_equal_runs_do_not_differ() -> None:
    rows = [row('a'), row('b', None), row('c', setting='s=1'), row('c', setting='s=2')]
    found = compare_runs(rows, list(reversed(rows)), 0.0)
    assert (found.same, found.pairs, found.changed) == (4, 4, False)


def test_the_distance_is_the_largest_at_the_required_places() -> None:
    half_degree = {'qz': 0.0043633, 'qw': 0.9999905}
    found = compare_runs([row('a'), row('b'), row('c')],
                         [row('a', 0.0004), row('b', **half_degree), row('c', 0.0006)], 0.0005)
    assert found.near == 1 and [pair.a['bag'] for pair in found.moved] == ['b', 'c']
    assert found.moved[0].moved_m == pytest.approx(0.1 * 0.0087266, rel=1e-4)
    assert found.changed


def test_another_verdict_is_listed_once() -> None:
    found = compare_runs([row('a'), row('b', grade='A'), row('c', None)],
                         [row('a', None), row('b', 0.1, grade='B'), row('c', None)], 0.0005)
    assert [pair.verdicts for pair in found.verdicts] == [
        ('registered', 'ambiguous'), ('registered (A)', 'registered (B)')]
    assert not found.moved and found.same == 1


@pytest.mark.parametrize('name', ['model_sha256', 'frame_id'])
def test_poses_of_another_bone_or_frame_are_not_compared(name: str) -> None:
    found = compare_runs([row('a')], [row('a', **{name: 'other'})], 0.0005)
    assert found.moved[0].moved_m is None and not found.moved[0].comparable and found.changed


def test_recordings_are_matched_by_content_then_by_path() -> None:
    found = compare_runs(
        [row('old/a'), row('b', bag_sha256='1'), row('c'), row('d', bag_sha256='')],
        [row('new/a'), row('b', bag_sha256='2'), row('e'), row('d', bag_sha256='')], 0.0)
    assert (found.same, found.other_content) == (3, 1)
    assert [each['bag'] for each in (*found.only_a, *found.only_b)] == ['c', 'e']
    assert found.changed
    equal = [row('x/a'), row('y/a')]        # two copies, in another order
    assert [(one['bag'], compare_runs(equal, equal[::-1], 0.0).same) for one in equal] == [
        ('x/a', 2), ('y/a', 2)]
