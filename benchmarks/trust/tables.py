# SPDX-License-Identifier: Apache-2.0
"""Count the right, wrong and refused poses of many trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.execution.result_table import Row
from benchmarks.protocol.trials import SCENARIOS
from gsdf_registration.common.rigid import rms

COLUMNS = ('scenario', 'trials', 'right', 'refused', 'wrong', 'understated', 'found',
           'efficiency', 'median', 'TRE', 'predicted', 'search', 'solve', 'refused for')


def table(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """
    Yield the confusion table, a line for each scenario and one for all, cells as text.

    Efficiency and TRE are of the right answers; lengths in mm, times (median) in ms.
    """
    present = {row['scenario'] for row in rows}
    for scenario in [*(name for name in SCENARIOS if name in present), 'all']:
        selected = [row for row in rows if scenario in (row['scenario'], 'all')]
        verdicts = Counter(row['verdict'] for row in selected)
        right = [row for row in selected if row['verdict'] == 'right']
        reasons = Counter(row['reason'] for row in selected if row['verdict'] == 'refused')
        efficiency = [np.sqrt(row['nees'] / 6.0) for row in right]
        yield (
            scenario, str(len(selected)),
            *(str(verdicts[v]) for v in ('right', 'refused', 'wrong', 'understated')),
            _figure(np.mean, [row['found'] for row in selected if row['found'] is not None],
                    '.1%'),
            _figure(rms, efficiency), _figure(np.median, efficiency),
            _figure(rms, [1e3 * row['tre_rms_m'] for row in right]),
            _figure(rms, [1e3 * row['predicted_rms_m'] for row in right]),
            *(_figure(np.median, [1e3 * row[key] for row in selected if row[key] is not None],
                      '.0f') for key in ('search_s', 'solve_s')),
            ', '.join(f'{count} {reason}' for reason, count in reasons.most_common()))


def faults(rows: Sequence[Row], verdict: str) -> list[Row]:
    """Return the rows of a verdict, wrong or understated."""
    return [row for row in rows if row['verdict'] == verdict]


def faulty_refusals(rows: Sequence[Row]) -> tuple[list[Row], int]:
    """Return the well-posed rows that were refused, and the number of well-posed rows."""
    selected = [row for row in rows if row['well_posed']]
    return [row for row in selected if row['verdict'] == 'refused'], len(selected)


def not_found(rows: Sequence[Row]) -> tuple[list[Row], int]:
    """
    Return the rows whose pose is not near the truth, and the number of rows that were checked.

    Hard cases are not checked.
    """
    selected = [row for row in rows if row['found'] is not None
           and not SCENARIOS[row['scenario']].hard]
    return [row for row in selected if not row['found']], len(selected)


def _figure(of: Callable[[Any], Any], values: Sequence[float], form: str = '.2f') -> str:
    return format(float(of(np.array(values))), form) if values else '-'
