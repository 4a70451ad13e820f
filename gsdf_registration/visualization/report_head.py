# SPDX-License-Identifier: Apache-2.0
"""The head of the report: verdict, case, bone, zone, grade, and limits beside values."""

from __future__ import annotations

import html
from pathlib import Path
from typing import NamedTuple

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import Reason
from gsdf_registration.visualization.report_content import ReportContent

GRADES = {'A': 'A: accurate on the whole bone',
          'B': 'B: accurate where it is required, not on the whole bone'}


class Gauge(NamedTuple):
    """A value beside its limit; ``minimum``: whether the value must not be below the limit."""

    name: str
    value: float
    limit: float
    unit: str
    minimum: bool = False

    @property
    def good(self) -> bool:
        """Whether the value is within the limit."""
        return self.value >= self.limit if self.minimum else self.value <= self.limit


def facts(content: ReportContent) -> str:
    """Return the facts that identify the registration, as HTML."""
    zone, model = content.result.zone, content.config.model
    bone = Path(model.path).name + (f', label {model.label}' if model.label else '')
    known = {'date': content.date, 'case': content.case, 'model': bone,
             'side': content.side or 'not stated',
             'zone': '' if zone is None or content.covariance is None else zone.sentence,
             'grade': GRADES.get(content.result.grade or '', '')}
    return ''.join(f'<div><dt>{name}</dt><dd>{html.escape(value)}</dd></div>'
                   for name, value in known.items() if value)


def gauges(content: ReportContent) -> list[Gauge]:
    """Return the values that decide about acceptance, beside their limits."""
    result, limits = content.result, content.config.limits
    found = []
    if result.zone is not None and content.covariance is not None:
        at_targets = bool(result.zone.p95_m) and limits.require in ('', 'targets')
        error = (max(result.zone.p95_m.values()) if at_targets else
                 result.zone.bone_p95_m if limits.require == 'bone' else result.zone.touched_p95_m)
        where = ('at the targets' if at_targets else 'on the whole bone'
                 if limits.require == 'bone' else 'around the touched area')
        found.append(Gauge(f'error {where} (95 %)', 1e3 * error, 1e3 * limits.max_error, 'mm'))
    if result.sigma_m is not None:
        found.append(Gauge('scatter of the points', 1e3 * result.sigma_m, 1e3 * limits.max_sigma,
                           'mm'))
    if result.used:
        found.append(Gauge('points on the bone', 100.0 * result.inliers / result.used,
                           100.0 * limits.min_inliers, '%', minimum=True))
    if content.verifications:
        worst = max(abs(each.distance_m) for each in content.verifications)
        found.append(Gauge(f'worst of {format_count(len(content.verifications), "verification")}',
                           1e3 * worst, 1e3 * limits.verification, 'mm'))
    return found


def gauge_bars(content: ReportContent) -> str:
    """Return the values beside their limits as HTML: 0.8 of 2 mm."""
    return ''.join(_bar(each) for each in gauges(content))


def advice(content: ReportContent) -> str:
    """Return what else to know about the outcome, as HTML: where to touch, rivals."""
    result, considered = content.result, content.result.considered
    if result.success or considered is None:
        return ''
    lines = [f'<li class="next">{number}: touch here; {html.escape(touch.expected_gain)}</li>'
             for number, touch in enumerate(considered.next_touches, start=1)]
    if considered.rivals:
        lines.append(f'<li>The points fit {len(considered.rivals) + 1} poses about equally well. '
                     'The 3-D view shows the points at each.</li>')
    if result.reason not in (Reason.AMBIGUOUS, Reason.UNDER_CONSTRAINED):
        lines.append('<li>The pictures show the best pose that was found. It was rejected.</li>')
    return f'<ul class="advice">{"".join(lines)}</ul>' if lines else ''


def _bar(gauge: Gauge) -> str:
    full = 100.0 if gauge.minimum else 2.0 * gauge.limit
    share = min(100.0 * gauge.value / full, 100.0)
    value = (f'{gauge.value:.0f} {gauge.unit}, at least {gauge.limit:.3g} {gauge.unit}'
             if gauge.minimum else f'{gauge.value:.1f} of {gauge.limit:.3g} {gauge.unit}')
    kind = 'good' if gauge.good else 'bad'
    return (f'<div class="gauge {kind}"><b>{html.escape(gauge.name)}</b><span>'
            f'{value}</span>'
            f'<div><i style="width:{share:.1f}%"></i><u style="left:'
            f'{100.0 * gauge.limit / full:.1f}%"></u></div></div>')
