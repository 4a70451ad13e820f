# SPDX-License-Identifier: Apache-2.0
"""Compare true with stated errors over many trials."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.calibration.trial import LOST
from benchmarks.execution.result_table import Row
from benchmarks.protocol.trials import SCENARIOS
from gsdf_registration.common.rigid import Array, rms

CHI_SQUARE_95 = 12.592      # 95 % quantile, 6 degrees of freedom
CHI_SQUARE_FAR = 30.0       # exceeded by 0.004 %
COLUMNS = ('scenario', 'trials', 'lost', '95 % region', '> 30', 'near true/stated', 'within 95 %',
           'far true/stated', 'within 95 %', 'near/bound', 'far/bound', 'efficiency', 'refused')
WIDTHS = (26, 7, 5, 12, 8, 18, 12, 17, 12, 11, 10, 11, 11)


def table(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """
    Yield a line for each scenario, for each region and for all trials, cells as text.

    Lost poses are in another minimum or without covariance; they are in no other column. Lengths
    are RMS in mm. Efficiency is the error of the pose over the Cramer-Rao bound, sqrt(NEES / 6).
    Refused: well-posed problems whose stated error is beyond the limit.
    """
    named = {row['scenario'] for row in rows}
    regions = sorted({row['case'].split('/')[1] for row in rows})
    groups = [(name, [row for row in rows if row['scenario'] == name])
              for name in SCENARIOS if name in named]
    groups += [(region, [row for row in rows if row['case'].endswith('/' + region)])
               for region in regions]
    for name, group in [*groups, ('all', list(rows))]:
        yield (name, *_cells(group))


def peer_table(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Yield a line for each peer and scenario, and for each peer; cells as in `table`."""
    for peer in dict.fromkeys(row['peer'] for row in rows):
        own = [row for row in rows if row['peer'] == peer]
        for name in dict.fromkeys(row['scenario'] for row in own):
            yield (f'  {name}', *_cells([row for row in own if row['scenario'] == name]))
        yield (peer, *_cells(own))


def _cells(group: Sequence[Row]) -> tuple[str, ...]:
    rows = [row for row in group if row['near_stated_m'] is not None and row['near_m'] < LOST]
    if not rows:
        return (str(len(group)), str(len(group)), *('-' for _ in COLUMNS[3:]))
    value = {key: np.array([row[key] for row in rows]) for key in rows[0]
             if isinstance(rows[0][key], float)}
    cells = [str(len(group)), str(len(group) - len(rows)),
             _share(value, 'chi_square', lambda squared: squared < CHI_SQUARE_95),
             _share(value, 'chi_square', lambda squared: squared > CHI_SQUARE_FAR)]
    for place in ('near', 'far'):
        true, stated = rms(1e3 * value[f'{place}_m']), rms(1e3 * value[f'{place}_stated_m'])
        cells += [f'{true:.2f} / {stated:.2f}', _share(value, f'{place}_within')]
    cells += [f'{rms(value[f"{place}_m"]) / rms(value[f"{place}_bound_m"]):.2f}'
              for place in ('near', 'far')]
    well_posed = [row for row in rows if row.get('well_posed')]
    refused = sum(row['share_of_limits'] > 1.0 for row in well_posed)
    return (*cells, f'{np.sqrt(value["nees"].mean() / 6.0):.2f}' if 'nees' in value else '-',
            f'{refused} of {len(well_posed)}' if 'share_of_limits' in value else '-')


def _share(value: dict[str, Array], key: str, of: Callable[[Array], Any] = np.asarray) -> str:
    """Return the mean of a column as a percentage; - if it is not stated."""
    return f'{np.mean(of(value[key])):.2%}' if key in value else '-'
