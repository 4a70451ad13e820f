# SPDX-License-Identifier: Apache-2.0
"""The tables of the experiments with the published figures, as TSV and Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np

from benchmarks.execution.result_table import Row
from benchmarks.paper.experiment import TABLES
from benchmarks.paper.published import LEVELS, REGIONS

TITLES = {'clean': 'isotropic noise, 0.5 mm', 'anisotropic': 'anisotropic noise, 0.3 0.5 0.7 mm'}
PUBLISHED = ' (published)'
Lines = list[list[str]]


@dataclass(frozen=True)
class Figures:
    """
    Figures of a method over several trials; degrees, millimetres, seconds.

    Errors are means over all returned poses, ``good_*`` over the successes; NaN: no pose.
    ``seconds`` is the median. ``wrong`` counts the accepted poses that are wrong; NaN for methods
    that never refuse.
    """

    trials: int
    poses: int
    success: float
    wrong: float
    rotation: float
    t_centroid: float
    t_origin: float
    tre_mean: float
    tre_p95: float
    tre_max: float
    chamfer: float
    good_rotation: float
    good_t_centroid: float
    seconds: float


def figures(rows: Sequence[Row]) -> Figures:
    """Return the figures over rows of one method."""
    poses = [row for row in rows if row['status'] == 'answered']
    good = [row for row in rows if row['success']]
    wrong = [row['wrong'] for row in poses if row['wrong'] is not None]

    def mean(key: str, of: Sequence[Row] = poses) -> float:
        unit = 1e3 if key.endswith('_m') else 1.0
        return unit * _of([row[key] for row in of], np.mean)
    return Figures(
        len(rows), len(poses), len(good) / len(rows), float(sum(wrong)) if wrong else np.nan,
        mean('rotation_mae_deg'), mean('t_centroid_mae_m'), mean('t_origin_mae_m'),
        mean('tre_mean_m'), mean('tre_p95_m'), mean('tre_max_m'), mean('chamfer_m'),
        mean('rotation_mae_deg', good), mean('t_centroid_mae_m', good),
        _of([row['seconds'] for row in poses], np.median))


def tsv(rows: Sequence[Row]) -> str:
    """Return all figures: a line per method, scenario and region, and for all regions."""
    names = [field.name for field in fields(Figures)]
    lines = ['\t'.join(['method', 'start', 'scenario', 'region', *names])]
    for method in _names(rows, 'method'):
        for scenario in _names(rows, 'scenario'):
            for region in ('all', *_names(rows, 'region')):
                selected = _pick(rows, method, scenario, region)
                if selected:
                    lines.append('\t'.join([method, selected[0]['start'], scenario, region] + [
                        f'{value:.6g}' for value in astuple(figures(selected))]))
    return '\n'.join(lines) + '\n'


def markdown(rows: Sequence[Row], missing: Mapping[str, str], caption: str) -> str:
    """
    Return the tables as a page.

    Parameters
    ----------
    rows : of all trials
    missing : methods that cannot be installed, and the reasons
    caption : text above the tables

    """
    present = set(_names(rows, 'scenario'))
    parts = [caption]
    for scenario in TABLES['regions']:
        if scenario in present:
            parts += [f'## Regions, {TITLES[scenario]}',
                      'MAE of rotation (degrees) / MAE of translation at the centroid (mm) / '
                      'Chamfer distance (mm), success', _table(_regions(rows, scenario))]
    for name, what in (('noise', 'Noise'), ('outliers', 'Outliers'),
                       ('structured', 'Structured interference'),
                       ('model', 'Inaccurate model, 0.3 mm (SD)'),
                       ('touches', 'Single touches, 0.3 mm; all methods with the same landmarks')):
        scenarios = [scenario for scenario in TABLES[name] if scenario in present]
        if scenarios:
            parts += [f'## {what}', 'MAE of rotation (degrees) / MAE of translation at the '
                      'centroid (mm) / time (s), success', _table(_levels(rows, scenarios))]
    parts.append('## All figures')
    for scenario in _names(rows, 'scenario'):
        parts += [f'### {scenario}', _table(_everything(rows, scenario))]
    if missing:
        parts += ['## Not installed', '\n'.join(f'- {name}: {why}'
                                                for name, why in missing.items())]
    return '\n\n'.join(parts) + '\n'


def _regions(rows: Sequence[Row], scenario: str) -> Lines:
    regions = _names(rows, 'region')
    lines = [['method', *regions]]
    lines += [[method] + [_cell(_pick(rows, method, scenario, region), lambda f: f.chamfer)
                          for region in regions] for method in _names(rows, 'method')]
    lines += [[method + PUBLISHED] + [_plain(published.get(region)) for region in regions]
              for method, published in REGIONS[scenario].items()]
    return _filled(lines)


def _levels(rows: Sequence[Row], scenarios: Sequence[str]) -> Lines:
    lines = [['method', *scenarios]]
    lines += [[method] + [_cell(_pick(rows, method, scenario, 'all'), lambda f: f.seconds)
                          for scenario in scenarios] for method in _names(rows, 'method')]
    lines.append(['the paper' + PUBLISHED] + [_plain(LEVELS.get(s)) for s in scenarios])
    return _filled(lines)


def _everything(rows: Sequence[Row], scenario: str) -> Lines:
    lines = [['method', 'start', 'trials', 'poses', 'success', 'wrong', 'MAE R', 'MAE t',
              't at origin', 'TRE mean', 'TRE p95', 'TRE max', 'Chamfer', 'MAE R, successes',
              'MAE t, successes', 'time']]
    for method in _names(rows, 'method'):
        selected = _pick(rows, method, scenario, 'all')
        if selected:
            f = figures(selected)
            lines.append([method, selected[0]['start'] or 'none', str(f.trials), str(f.poses),
                          f'{100.0 * f.success:.0f} %', _number(f.wrong)]
                         + [_number(value) for value in astuple(f)[4:]])
    return lines


def _cell(rows: Sequence[Row], third: Callable[[Figures], float]) -> str:
    if not rows:
        return ''
    f = figures(rows)
    if not f.poses:
        return ', '.join(dict.fromkeys(row['status'] for row in rows))
    numbers = ' / '.join(_number(value) for value in (f.rotation, f.t_centroid, third(f)))
    return f'{numbers}, {100.0 * f.success:.0f} %'


def _plain(published: Iterable[float] | None) -> str:
    return '' if published is None else ' / '.join(_number(value) for value in published)


def _number(value: float) -> str:
    if np.isnan(value):
        return '-'
    return f'{value:.0f}' if abs(value) >= 100.0 else f'{value:.3g}'


def _table(lines: Lines) -> str:
    rule = ['---'] * len(lines[0])
    return '\n'.join('| ' + ' | '.join(cells) + ' |' for cells in [lines[0], rule, *lines[1:]])


def _filled(lines: Lines) -> Lines:
    """Return the lines that have at least one cell besides the name."""
    return [line for line in lines if any(line[1:])]


def _pick(rows: Sequence[Row], method: str, scenario: str, region: str) -> list[Row]:
    return [row for row in rows if row['method'] == method and row['scenario'] == scenario
            and region in ('all', row['region'])]


def _names(rows: Sequence[Row], key: str) -> list[str]:
    return list(dict.fromkeys(row[key] for row in rows))


def _of(values: Sequence[float], statistic: Callable[[Sequence[float]], float]) -> float:
    return float(statistic(values)) if values else np.nan
