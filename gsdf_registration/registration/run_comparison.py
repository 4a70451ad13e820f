# SPDX-License-Identifier: Apache-2.0
"""Compare two runs over an archive of recordings: which results changed, and by how much."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from dataclasses import field as item
from typing import Any

import numpy as np

from gsdf_registration.common.result import Reason
from gsdf_registration.common.rigid import Array, displacement, from_rt, rotation_from_quaternion

POSITION, ORIENTATION = ('x_m', 'y_m', 'z_m'), ('qx', 'qy', 'qz', 'qw')
# columns that are kept; those of a whole row are too large for a million of rows
KEPT = ('bag', 'label', 'setting', 'reason', 'grade', 'frame_id', *POSITION, *ORIENTATION,
        'places_m', 'bag_sha256', 'model_sha256', 'settings_sha256', 'version', 'result', 'report')
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Pair:
    """
    The results of one recording in two runs.

    a, b : rows of the tables
    moved_m : float, m, the largest distance between the poses where they must be accurate; None
        without two poses of one bone in one frame
    """

    a: Row
    b: Row
    moved_m: float | None

    @property
    def verdicts(self) -> tuple[str, str]:
        """What was answered: registered with its grade, or the reason of the refusal."""
        return verdict(self.a), verdict(self.b)

    @property
    def comparable(self) -> bool:
        """Whether the answers are about the same bone and frame."""
        return self.moved_m is not None or not (_has_pose(self.a) and _has_pose(self.b))


@dataclass(frozen=True)
class RunComparison:
    """
    How two runs differ.

    limit_m : float, m: poses that are farther apart are listed
    same : number of pairs with the same answer, to the bit
    near : number of pairs whose poses are at most ``limit_m`` apart
    moved : pairs whose poses are farther apart, or cannot be compared; the farthest first
    verdicts : pairs with another verdict
    only_a, only_b : rows of recordings that the other run does not have
    other_content : number of pairs that were matched by the path, but whose recordings differ
    settings : pairs of hashes of the settings that were compared
    versions : of the program, of each run
    """

    limit_m: float
    same: int
    near: int
    moved: list[Pair]
    verdicts: list[Pair]
    only_a: list[Row]
    only_b: list[Row]
    other_content: int
    settings: set[tuple[str, str]] = item(default_factory=set)
    versions: tuple[set[str], set[str]] = item(default_factory=lambda: (set(), set()))

    @property
    def pairs(self) -> int:
        """Number of recordings (with a setting) in both runs."""
        return self.same + self.near + len(self.moved) + len(self.verdicts)

    @property
    def changed(self) -> bool:
        """Whether there is a difference beyond the limit."""
        return bool(self.moved or self.verdicts or self.only_a or self.only_b)


def verdict(row: Row) -> str:
    """Return the verdict of a row in words."""
    if row['reason'] != Reason.CONVERGED.value:
        return str(row['reason']).replace('_', ' ')
    return f'registered ({row["grade"]})' if row['grade'] else 'registered'


def compare_runs(a: Iterable[Row], b: Iterable[Row], limit_m: float) -> RunComparison:
    """
    Return how two tables of an archive differ.

    Recordings are matched by their content, so that an archive may move, and else by their path.

    Parameters
    ----------
    a, b : rows, see the columns of `KEPT`
    limit_m : float, m

    """
    pairs, only_a, only_b = _matched([_kept(row) for row in a], [_kept(row) for row in b])
    same = near = other_content = 0
    moved, verdicts = list[Pair](), list[Pair]()
    settings, versions = set[tuple[str, str]](), (set[str](), set[str]())
    for one, other in pairs:
        pair = Pair(one, other, _distance(one, other))
        other_content += one['bag_sha256'] != other['bag_sha256']
        settings.add((one['settings_sha256'], other['settings_sha256']))
        for version, row in zip(versions, (one, other)):
            version.add(row['version'])
        if pair.verdicts[0] != pair.verdicts[1]:
            verdicts.append(pair)
        elif not pair.comparable or (pair.moved_m or 0.0) > limit_m:
            moved.append(pair)
        elif _pose(one) == _pose(other):
            same += 1
        else:
            near += 1
    moved.sort(key=lambda pair: -(np.inf if pair.moved_m is None else pair.moved_m))
    return RunComparison(limit_m, same, near, moved, verdicts, only_a, only_b, other_content,
                         settings, versions)


def _kept(row: Row) -> Row:
    return {name: row[name] for name in KEPT}


def _matched(a: list[Row], b: list[Row]) -> tuple[list[tuple[Row, Row]], list[Row], list[Row]]:
    """Return the pairs in the order of ``a``, and the rows without a partner."""
    partner: dict[int, int] = {}
    taken = set[int]()
    for names in (('bag_sha256', 'bag', 'label', 'setting'), ('bag_sha256', 'label', 'setting'),
                  ('bag', 'label', 'setting'), ('bag_sha256', 'setting')):
        places = defaultdict[tuple[Any, ...], list[int]](list)
        for j in reversed(range(len(b))):
            if j not in taken:
                places[tuple(b[j][name] or '' for name in names)].append(j)
        for i, row in enumerate(a):
            key = tuple(row[name] or '' for name in names)
            if i not in partner and key[0] and places.get(key):
                partner[i] = places[key].pop()
                taken.add(partner[i])
    return ([(a[i], b[partner[i]]) for i in sorted(partner)],
            [row for i, row in enumerate(a) if i not in partner],
            [row for j, row in enumerate(b) if j not in taken])


def _has_pose(row: Row) -> bool:
    return row['x_m'] is not None


def _pose(row: Row) -> tuple[Any, ...]:
    return tuple(row[name] for name in (*POSITION, *ORIENTATION))


def _distance(a: Row, b: Row) -> float | None:
    """Return the largest distance between the poses at the places of ``a``, m."""
    if not (_has_pose(a) and _has_pose(b)) or any(
            (a[name] or '') != (b[name] or '') for name in ('model_sha256', 'frame_id')):
        return None
    places = np.reshape(json.loads(a['places_m'] or b['places_m'] or '[]') or [[0.0] * 3], (-1, 3))
    return float(displacement(_matrix(a), _matrix(b), places).max())


def _matrix(row: Row) -> Array:
    return from_rt(rotation_from_quaternion(np.array([row[name] for name in ORIENTATION])),
                   np.array([row[name] for name in POSITION]))
