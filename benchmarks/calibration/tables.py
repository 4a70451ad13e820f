# SPDX-License-Identifier: Apache-2.0
"""Compare true with stated errors over many trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.calibration.trial import LOST
from benchmarks.execution.result_table import Row
from benchmarks.protocol.trials import SCENARIOS
from gsdf_registration.common.rigid import Array, rms

CHI_SQUARE_95 = 12.592      # 95 % quantile, 6 degrees of freedom
CHI_SQUARE_FAR = 30.0       # exceeded by 0.004 %
COLUMNS = ('scenario', 'trials', 'lost', '95 % region', '> 30', 'near true/stated', 'within 95 %',
           'far true/stated', 'within 95 %', 'near/bound', 'far/bound', 'efficiency', 'refused',
           'not seen')
WIDTHS = (26, 7, 5, 12, 8, 18, 12, 17, 12, 11, 10, 11, 12, 12)
COST_COLUMNS = ('model error', 'covariance', 'exact: held', 'refused', 'inexact: held', '> 30',
                'refused')
COST_WIDTHS = (12, 11, 12, 16, 14, 8, 16)
FACTORS = (0.7, 1.0, 1.5, 2.0, 4.0)     # of the stated covariance


def table(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """
    Yield a line for each scenario, for each region and for all trials, cells as text.

    Lost poses are in another minimum or without covariance; they are in no other column. Lengths
    are RMS in mm. Efficiency is the error of the pose over the Cramer-Rao bound, sqrt(NEES / 6).
    Refused: well-posed problems whose stated error is beyond the limit. Not seen: trials whose
    deviation the best test misses, see `_not_seen`.
    """
    named = {row['scenario'] for row in rows}
    regions = sorted({row['case'].split('/')[1] for row in rows})
    groups = [(name, [row for row in rows if row['scenario'] == name])
              for name in SCENARIOS if name in named]
    groups += [(region, [row for row in rows if row['case'].endswith('/' + region)])
               for region in regions]
    for name, group in [*groups, ('all', list(rows))]:
        yield (name, *_cells(group))


def cost_table(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """
    Yield a line for each multiple of the stated covariance, cells as text, lost poses left out.

    Where no error of the model was found, exact and inexact models are not distinguished, so they
    have the same factor. Held: share of the poses in the 95 % region; refused as in `table`.
    """
    stated = [row for row in rows if row['chi_square'] is not None and row['near_m'] < LOST]
    for label, group in (('not found', [row for row in stated if not row['model_sd_m']]),
                         ('found', [row for row in stated if row['model_sd_m']]),
                         ('all', stated)):
        exact, inexact = ([row for row in group if bool(SCENARIOS[row['scenario']].real_model) is
                           real] for real in (False, True))
        for factor in FACTORS:
            yield (label, f'x {factor:g}', _beyond(exact, factor, CHI_SQUARE_95, held=True),
                   _refused(exact, factor), _beyond(inexact, factor, CHI_SQUARE_95, held=True),
                   _beyond(inexact, factor, CHI_SQUARE_FAR), _refused(inexact, factor))


def _beyond(rows: Sequence[Row], factor: float, limit: float, held: bool = False) -> str:
    """Return the share of the poses beyond a chi-square, or ``held`` within it."""
    if not rows:
        return '-'
    share = np.mean([row['chi_square'] > factor * limit for row in rows])
    return f'{1.0 - share if held else share:.2%}'


def _refused(rows: Sequence[Row], factor: float = 1.0) -> str:
    """Return how many of the well-posed problems are refused."""
    well_posed = [row['share_of_limits'] for row in rows if row.get('well_posed')]
    refused = sum(np.sqrt(factor) * share > 1.0 for share in well_posed)
    return f'{refused} of {len(well_posed)}' if well_posed else '-'


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
             if not key.startswith('evidence') and isinstance(rows[0][key], float)}
    known = [row for row in rows if row['chi_square'] is not None]
    cells = [str(len(group)), str(len(group) - len(rows)),
             _beyond(known, 1.0, CHI_SQUARE_95, held=True), _beyond(known, 1.0, CHI_SQUARE_FAR)]
    for place in ('near', 'far'):
        true, stated = rms(1e3 * value[f'{place}_m']), rms(1e3 * value[f'{place}_stated_m'])
        cells += [f'{true:.2f} / {stated:.2f}', _share(value, f'{place}_within')]
    cells += [f'{rms(value[f"{place}_m"]) / rms(value[f"{place}_bound_m"]):.2f}'
              for place in ('near', 'far')]
    return (*cells, f'{np.sqrt(value["nees"].mean() / 6.0):.2f}' if 'nees' in value else '-',
            _refused(rows), _not_seen(rows))


def _not_seen(rows: Sequence[Row]) -> str:
    """
    Return how often the most powerful test misses the deviation, with 5 % of false alarms.

    There is one test for each scenario.
    """
    known = [(row['evidence'], row['evidence_exact']) for row in rows
             if row.get('evidence') is not None]
    if not known or len({row['scenario'] for row in rows}) > 1:
        return '-'
    deviating, exact = np.array(known).T
    return f'{np.mean(deviating < np.quantile(exact, 0.95)):.1%}'


def _share(value: dict[str, Array], key: str) -> str:
    """Return the mean of a column as a percentage; - if it is not stated."""
    return f'{value[key].mean():.2%}' if key in value else '-'
