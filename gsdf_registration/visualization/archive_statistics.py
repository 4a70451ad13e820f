# SPDX-License-Identifier: Apache-2.0
"""What the rows of an archive amount to: outcomes, errors, the slowest and the worst."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from gsdf_registration.common.rigid import Array

Row = Mapping[str, Any]
SUCCESS = 'converged'
MOST = 10           # rows of the slowest and of the worst
MOST_LISTED = 2000  # rows of the list
# name of a column -> title; the first are shown first
MEASURES = {'required_p95_m': 'stated error (95 %) where the pose must be accurate, mm',
            'true_required_m': 'true error there, mm',
            'true_rms_m': 'true error over the bone (RMS), mm'}


class Statistics:
    """
    Statistics of rows, which are seen once: there may be a million of them.

    Attributes
    ----------
    total : number of rows
    reasons : for each setting of a sweep, the number of rows of each reason
    grades : for each setting, the number of rows of each grade
    listed : the first rows
    unusual : the rows without a pose that are not among ``listed``, up to as many
    versions : of the program

    """

    def __init__(self, rows: Iterable[Row]) -> None:
        self.total = 0
        self.reasons: dict[str, Counter[str]] = {}
        self.grades: dict[str, Counter[str]] = {}
        self.listed: list[Row] = []
        self.unusual: list[Row] = []
        self.versions: set[str] = set()
        self._values: dict[tuple[str, str], list[float]] = {}
        self._slowest: list[tuple[float, int, Row]] = []
        self._worst: dict[str, list[tuple[float, int, Row]]] = {name: [] for name in MEASURES}
        for row in rows:
            self._add(row)

    def _add(self, row: Row) -> None:
        setting = row['setting']
        self.total += 1
        self.versions.add(row['version'])
        self.reasons.setdefault(setting, Counter())[row['reason']] += 1
        if row['grade']:
            self.grades.setdefault(setting, Counter())[row['grade']] += 1
        if len(self.listed) < MOST_LISTED:
            self.listed.append(row)
        elif row['reason'] != SUCCESS and len(self.unusual) < MOST_LISTED:
            self.unusual.append(row)
        if row['total_s'] is not None:
            self._values.setdefault((setting, 'total_s'), []).append(row['total_s'])
            _keep(self._slowest, row['total_s'], self.total, row)
        if row['reason'] != SUCCESS:
            return
        for name in MEASURES:
            if row[name] is not None:
                self._values.setdefault((setting, name), []).append(row[name])
                _keep(self._worst[name], row[name], self.total, row)

    @property
    def registered(self) -> int:
        """Number of rows with a pose."""
        return sum(counts[SUCCESS] for counts in self.reasons.values())

    def values(self, setting: str, name: str) -> Array:
        """Return a column of a setting, without unknown values; errors only of poses."""
        return np.array(self._values.get((setting, name), []))

    def slowest(self) -> list[Row]:
        """Return the rows that took longest, longest first."""
        return [row for _, _, row in sorted(self._slowest, reverse=True)]

    def worst(self) -> tuple[str, list[Row]]:
        """Return the rows with the largest errors, and the column: true errors if known."""
        name = 'true_required_m' if self._worst['true_required_m'] else 'required_p95_m'
        return name, [row for _, _, row in sorted(self._worst[name], reverse=True)]


def _keep(heap: list[tuple[float, int, Row]], value: float, number: int, row: Row) -> None:
    """Keep the `MOST` largest values; of equal ones the first."""
    heapq.heappush(heap, (value, -number, row))
    if len(heap) > MOST:
        heapq.heappop(heap)
