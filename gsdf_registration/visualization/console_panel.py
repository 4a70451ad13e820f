# SPDX-License-Identifier: Apache-2.0
"""
The text of the operator's console as HTML: the verdict in words, limits beside values, counters.

All functions are pure: they take the values of ``~/status`` and return HTML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape

from gsdf_registration.common.formatting import format_error

Values = Mapping[str, str]

# state -> headline and colour
HEADLINES = {
    'no_model': ('No bone model', 'bad'),
    'idle': ('Not collecting', 'quiet'),
    'collecting': ('Collecting', 'active'),
    'ready': ('Ready to register', 'good'),
    'solving': ('Registering', 'active'),
    'registered': ('Registered', 'good'),
    'refused': ('Refused', 'warn'),
}
UNKNOWN = ('No connection to the node', 'bad')

# cause of rejection -> words; others are shown with spaces instead of underscores
CAUSES = {
    'not_finite': 'not a number',
    'bad_quaternion': 'tool pose without an orientation',
    'wrong_frame': 'in another frame',
    'no_reference': 'reference array not in view',
    'not_monotonic': 'stamp not later than the one before',
    'stale': 'late',
    'poor_quality': 'poor tracking',
    'not_collecting': 'while not collecting',
    'touched': 'at a landmark or verification point',
    'duplicate': 'tip did not move',
    'calibrating': 'used for a calibration',
    'too_fast': 'jumped',
    'lost': 'lost on the network',
    'full': 'no more room',
}

STYLE = """<style>
.gsdf { font: 15px/1.35 system-ui, sans-serif; padding: 2px 10px 6px }
.gsdf .big { font-size: 26px; font-weight: 650; line-height: 1.15 }
.gsdf .good { color: #4cc38a } .gsdf .warn { color: #f5b83d } .gsdf .bad { color: #ff6b62 }
.gsdf .active { color: #6cb6ff } .gsdf .quiet { color: #a9b1ba }
.gsdf table { width: 100%; border-collapse: collapse }
.gsdf td { padding: 2px 0; vertical-align: top }
.gsdf td + td { text-align: right; white-space: nowrap; padding-left: 8px }
.mantine-Button-root { min-height: 46px; font-size: 16px }
.gsdf .bar { height: 6px; border-radius: 3px; background: #8884; margin: 1px 0 5px }
.gsdf .bar i { display: block; height: 100%; border-radius: 3px; background: currentColor }
.gsdf .flash { animation: gsdf-flash 1s 3 }
@keyframes gsdf-flash { 50% { background: #4cc38a66 } }
</style>""".replace('\n', ' ')


@dataclass(frozen=True)
class Limits:
    """The settings that are shown beside values, SI units; None: not known yet."""

    max_sigma: float | None = None
    verification: float | None = None


@dataclass(frozen=True)
class Tracker:
    """How the samples of the probe arrive: rate, Hz, and time since the last one, s."""

    rate: float = 0.0
    silence: float | None = None    # None: no sample yet


def verdict(values: Values | None, message: str = '', flash: bool = False) -> str:
    """Return the headline and the sentence of a status; None: the node is not connected."""
    if values is None:
        return _page(f'<div class="big bad">{UNKNOWN[0]}</div>')
    words, tone = HEADLINES.get(values.get('state', ''), UNKNOWN)
    grade = values.get('grade', '')
    if values.get('state') == 'registered' and grade:
        words = f'{words}: grade {grade}'
    withdrawn = values.get('withdrawn', '')
    lost = f'<div class="warn">No pose: {escape(withdrawn.replace("_", " "))}</div>' if (
        withdrawn and values.get('pose') == 'none') else ''
    shine = ' flash' if flash else ''
    return _page(f'<div class="big {tone}{shine}">{words}</div>{lost}'
                 f'<div>{escape(_capitalized(message))}</div>')


def accuracy(values: Values, limits: Limits) -> str:
    """Return the values that have a limit, each with its limit and a bar."""
    rows = list(_accuracy_rows(values, limits))
    if not rows:
        return _page('<div class="quiet">No pose yet: the accuracy appears here</div>')
    return _page(''.join(_bar(*row) for row in rows))


def _accuracy_rows(values: Values, limits: Limits) -> Iterator[tuple[str, float, float | None]]:
    """Yield name, value and limit."""
    limit = _number(values, 'zone.limit_m')
    if limit is not None:
        prefix = 'zone.p95_m.'
        for key in values:
            if key.startswith(prefix):
                yield f'Error at {key.removeprefix(prefix)} (95 %)', float(values[key]), limit
        for key, where in (('zone.touched_p95_m', 'around the touched area'),
                           ('zone.bone_p95_m', 'on the whole bone')):
            value = _number(values, key)
            if value is not None:
                yield f'Error {where} (95 %)', value, limit
    sigma = _number(values, 'sigma_m')
    if sigma is not None:
        yield 'Scatter of the points (not the accuracy)', sigma, limits.max_sigma


def tracking(tracker: Tracker) -> str:
    """Return whether the tracker sees the probe."""
    if tracker.silence is None:
        return _page('<span class="warn">Probe not seen yet</span>')
    if tracker.silence > 1.0:
        return _page(f'<span class="bad">Probe not seen for {tracker.silence:.0f} s</span>')
    return _page(f'<span class="good">Probe in view</span> <span class="quiet">{tracker.rate:.0f} '
                 'samples per second</span>')


def counters(values: Values) -> str:
    """Return how many samples arrived and why some were not kept; the counts add up."""
    rejected = {key.removeprefix('rejected.'): int(value) for key, value in values.items()
                if key.startswith('rejected.')}
    rows = [('Received', values.get('received', '0')), ('Kept', values.get('kept', '0')),
            *((_capitalized(CAUSES.get(cause, cause.replace('_', ' '))), str(count))
              for cause, count in rejected.items() if count)]
    return _page(_table(rows))


def strokes(values: Values) -> dict[int, str]:
    """Return the sentence on each stroke by its number."""
    return {int(key.removeprefix('stroke.')): value for key, value in values.items()
            if key.startswith('stroke.')}


def landmarks(values: Values, names: list[str]) -> str:
    """Return the landmarks with their distance from the model, and which one is next."""
    if not names:
        return _page('<div class="quiet">No landmarks are configured</div>')
    done = int(values.get('landmarks', '0'))
    rows = []
    for number, name in enumerate(names):
        miss = _number(values, f'landmark_miss_m.{name}')
        state = ('next: hold the tip on it' if number == done else '' if number > done else
                 'captured' if miss is None else f'{format_error(miss)} off')
        rows.append((name, state))
    return _page(_table(rows))


def verification(values: Values) -> str:
    """Return the verification points against their limit."""
    sentence = values.get('verification', '')
    return _page(escape(_capitalized(sentence)) or
                 '<span class="quiet">No verification points yet</span>')


def _page(content: str) -> str:
    return f'{STYLE}<div class="gsdf">{content}</div>'


def _table(rows: list[tuple[str, str]]) -> str:
    return '<table>' + ''.join(f'<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>'
                               for name, value in rows) + '</table>'


def _bar(name: str, value: float, limit: float | None) -> str:
    """Return a value beside its limit: 0.8 of 2.0 mm."""
    if limit is None:
        return f'<table><tr><td>{escape(name)}</td><td>{format_error(value)}</td></tr></table>'
    tone = 'good' if value <= limit else 'warn'
    share = min(100.0 * value / limit, 100.0)
    number = format_error(value).removesuffix(' mm')
    return (f'<table><tr><td>{escape(name)}</td><td class="{tone}">{escape(number)} of '
            f'{format_error(limit)}</td></tr></table>'
            f'<div class="bar {tone}"><i style="width:{share:.0f}%"></i></div>')


def _number(values: Values, key: str) -> float | None:
    try:
        return float(values[key])
    except (KeyError, ValueError):
        return None


def _capitalized(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
