# SPDX-License-Identifier: Apache-2.0
"""Compare true with stated errors over many trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.calibration.trial import LOST
from benchmarks.execution.result_table import Row
from benchmarks.protocol.trials import SCENARIOS
from gsdf_registration.common.rigid import rms

CHI_SQUARE_95 = 12.592      # 95 % quantile, 6 degrees of freedom
CHI_SQUARE_FAR = 30.0       # exceeded by 0.004 %
COLUMNS = ('scenario', 'trials', 'lost', '95 % region', '> 30', 'near true/stated', 'within 95 %',
           'far true/stated', 'within 95 %', 'near/bound', 'far/bound', 'efficiency')
WIDTHS = (26, 7, 5, 12, 8, 18, 12, 17, 12, 11, 10, 11)


def table(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """
    Yield a line for each scenario, for each region and for all trials, cells as text.

    Lost poses are in another minimum or without covariance; they are in no other column. Lengths
    are RMS in mm. Efficiency is the error of the pose over the Cramer-Rao bound, sqrt(NEES / 6).
    """
    named = {row['scenario'] for row in rows}
    regions = sorted({row['case'].split('/')[1] for row in rows})
    groups = [(name, [row for row in rows if row['scenario'] == name])
              for name in SCENARIOS if name in named]
    groups += [(region, [row for row in rows if row['case'].endswith('/' + region)])
               for region in regions]
    for name, group in [*groups, ('all', list(rows))]:
        yield (name, *_cells(group))


def _cells(group: Sequence[Row]) -> tuple[str, ...]:
    rows = [row for row in group if row['chi_square'] is not None and row['near_m'] < LOST]
    if not rows:
        return (str(len(group)), str(len(group)), *('-' for _ in COLUMNS[3:]))
    value = {key: np.array([row[key] for row in rows]) for key in rows[0]
             if isinstance(rows[0][key], float)}
    chi_square, cells = value['chi_square'], []
    for place in ('near', 'far'):
        true, stated = rms(1e3 * value[f'{place}_m']), rms(1e3 * value[f'{place}_stated_m'])
        cells += [f'{true:.2f} / {stated:.2f}', f'{value[f"{place}_within"].mean():.1%}']
    return (str(len(group)), str(len(group) - len(rows)),
            f'{(chi_square < CHI_SQUARE_95).mean():.1%}',
            f'{(chi_square > CHI_SQUARE_FAR).mean():.2%}', *cells,
            *(f'{rms(value[f"{place}_m"]) / rms(value[f"{place}_bound_m"]):.2f}'
              for place in ('near', 'far')), f'{np.sqrt(value["nees"].mean() / 6.0):.2f}')
