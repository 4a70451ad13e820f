# SPDX-License-Identifier: Apache-2.0
"""
The text of the operator's console as HTML: the verdict in words, limits beside values, counters.

All functions are pure: they take the values of ``~/status`` and return HTML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from gsdf_registration.common.formatting import format_error
from gsdf_registration.visualization import colours

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
VERDICT = 2         # parts of a message below the headline; the others are hints

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
    'undone': 'in strokes that were dropped',
}

# Put once into the page. Below 576 px, viser shows the panel as a sheet at the bottom, over the
# picture; here the sheet is as wide as the screen and the picture ends above it.
STYLE = """<style>
.gsdf { font: 15px/1.35 system-ui, sans-serif; padding: 2px 10px 6px }
.gsdf .big { font-size: 26px; font-weight: 650; line-height: 1.15 }
.gsdf .good { color: #4cc38a } .gsdf .warn { color: #f5b83d } .gsdf .bad { color: #ff6b62 }
.gsdf .active { color: #6cb6ff } .gsdf .quiet, .gsdf .hint { color: #a9b1ba }
.gsdf .hint { font-size: 13px; margin-top: 3px; overflow-wrap: anywhere }
.gsdf .next { border-left: 4px solid #00a676; padding-left: 8px; margin-top: 4px }
.gsdf table { width: 100%; border-collapse: collapse }
.gsdf td { padding: 2px 0; vertical-align: top }
.gsdf td + td { text-align: right; padding-left: 8px }
.gsdf td.value { white-space: nowrap }
.gsdf .bar { height: 6px; border-radius: 3px; background: #8884; margin: 1px 0 5px }
.gsdf .bar i { display: block; height: 100%; border-radius: 3px; background: currentColor }
.gsdf .scale { height: 12px; border-radius: 3px; margin: 8px 0 1px }
.gsdf .marks { display: flex; justify-content: space-between; font-size: 13px; color: #a9b1ba }
.gsdf .flash { animation: gsdf-flash 1s 3 }
@keyframes gsdf-flash { 50% { background: #4cc38a66 } }
.mantine-Button-root { min-height: 46px; font-size: 15px; padding-inline: 6px }
[role="tab"] { min-height: 44px; padding: 0 7px !important }
[role="tablist"] { background-size: 100% 44px !important }
.mantine-Checkbox-body { min-height: 44px; align-items: center }
div:has(> .mantine-Button-root[id]) { display: inline-block; width: calc(50% - 16px);
  margin: 0 0 0 10px !important }
div:has(> .gsdf > .probe) + div:has(> .mantine-Button-root[id]) { width: calc(100% - 22px) }
@media (max-width: 576px) {
  .gsdf .big { font-size: 22px }
  div:has(> .mantine-Paper-root[style*="max-height: 60%"]) { flex-direction: column }
  div:has(canvas):has(+ .mantine-Paper-root[style*="max-height: 60%"]) { min-height: 0;
    flex: 1 1 0 !important }
  .mantine-Paper-root[style*="max-height: 60%"] { position: relative !important;
    width: 100% !important; max-height: 56vh !important; flex: none !important }
  .mantine-Paper-root[style*="max-height: 60%"] div[style*="width: 20em"] {
    width: 100% !important }
}
</style>""".replace('\n', ' ')


@dataclass(frozen=True)
class Limits:
    """The settings that are shown beside values, SI units; None: not known yet."""

    max_sigma: float | None = None
    max_error: float | None = None
    verification: float | None = None


@dataclass(frozen=True)
class Tracker:
    """How the samples of the probe arrive: rate, Hz, and time since the last one, s."""

    rate: float = 0.0
    silence: float | None = None    # None: no sample yet


def verdict(values: Values | None, message: str = '', flash: bool = False) -> str:
    """Return the headline and the start of a message; None: the node is not connected."""
    if values is None:
        return _page(f'<div class="big bad">{UNKNOWN[0]}</div>')
    words, tone = HEADLINES.get(values.get('state', ''), UNKNOWN)
    if values.get('state') == 'no_model' and values.get('progress'):
        words, tone = 'Loading the bone', 'active'
    if values.get('state') == 'registered' and values.get('grade'):
        words = f'{words}: grade {values["grade"]}'
    withdrawn = values.get('withdrawn', '')
    lost = f'<div class="warn">No pose: {escape(withdrawn.replace("_", " "))}</div>' if (
        withdrawn and values.get('pose') == 'none') else ''
    shine = ' flash' if flash else ''
    return _page(f'<div class="big {tone}{shine}">{escape(words)}</div>{lost}'
                 + ''.join(f'<div>{escape(part)}</div>'
                           for part in _parts(values, message)[:VERDICT]))


def hints(values: Values | None, message: str) -> str:
    """Return the rest of a message, in smaller letters."""
    return _page(''.join(f'<div class="hint">{escape(part)}</div>'
                         for part in _parts(values or {}, message)[VERDICT:]))


def labels(values: Values) -> dict[str, str]:
    """Return the labels of the buttons that do something else each time, by action."""
    calibration = values.get('calibration', '')
    return {'collect': 'Pause' if values.get('collecting') == 'true' else 'New stroke',
            'calibrate_tip': 'End calibration' if calibration == 'calibrate_tip'
            else 'Calibrate tip',
            'find_joint_centre': 'End swinging' if calibration == 'find_joint_centre'
            else 'Find joint centre'}


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


def legend(limits: Limits) -> str:
    """Return the two colour scales; they are the same in every session with the same limits."""
    scales = []
    if limits.max_error is not None:
        scales.append(_scale('Bone: error to expect (95 %)', colours.ERROR, (
            '0', f'{format_error(limits.max_error)}, border', format_error(
                colours.ERROR_SCALE * limits.max_error))))
    if limits.max_sigma is not None:
        scales.append(_scale('Points: distance from the bone', colours.RESIDUAL, (
            '0', format_error(limits.max_sigma))) + _page(
                f'<span style="color:{colours.UNUSED}">&#9679;</span> not used &emsp;'
                f'<span style="color:{colours.NEXT}">&#9679;</span> touch next'))
    return ''.join(scales)


def tracking(tracker: Tracker | None, values: Values | None = None) -> str:
    """Return whether the tracker, if there is one, sees the probe, and where to touch next."""
    if tracker is None:
        seen = ''
    elif tracker.silence is None:
        seen = '<span class="warn">Probe not seen yet</span>'
    elif tracker.silence > 1.0:
        seen = f'<span class="bad">Probe not seen for {tracker.silence:.0f} s</span>'
    else:
        seen = (f'<span class="good">Probe in view</span> <span class="quiet">{tracker.rate:.0f} '
                'samples per second</span>')
    place = (values or {}).get('touch_next', '')
    following = f'<div class="next">{escape(_capitalized(place))}</div>' if place else ''
    return _page(f'<div class="probe">{seen}</div>{following}')


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


def stroke(sentence: str) -> str:
    """Return the sentence on a stroke."""
    return _page(escape(_capitalized(sentence)))


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


def verification(values: Values, limits: Limits) -> str:
    """Return the verification points, each with its distance from the bone and the limit."""
    prefix = 'verification_m.'
    rows = [_bar(f'Point {key.removeprefix(prefix)}', abs(float(value)), limits.verification)
            for key, value in values.items() if key.startswith(prefix)]
    sentence = values.get('verification', '')
    if not sentence:
        return _page('<span class="quiet">No verification points yet: hold the tip on the bone and '
                     'press Verify</span>')
    return _page(''.join(rows) + f'<div class="hint">{escape(_capitalized(sentence))}</div>')


def _parts(values: Values, message: str) -> list[str]:
    """Return the parts of a message that are not shown elsewhere: headline, where to touch."""
    parts = [_capitalized(part) for part in message.split('; ')
             if part and part != values.get('touch_next')]
    headline = HEADLINES.get(values.get('state', ''), UNKNOWN)[0]
    return parts[1:] if parts[:1] == [headline] else parts


def _page(content: str) -> str:
    return f'<div class="gsdf">{content}</div>'


def _scale(name: str, shades: Sequence[str], marks: Sequence[str]) -> str:
    """Return a scale of colours with numbers below it."""
    return _page(f'{escape(name)}<div class="scale" style="background:linear-gradient(90deg,'
                 f'{",".join(shades)})"></div><div class="marks">'
                 + ''.join(f'<span>{escape(mark)}</span>' for mark in marks) + '</div>')


def _table(rows: list[tuple[str, str]]) -> str:
    return '<table>' + ''.join(f'<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>'
                               for name, value in rows) + '</table>'


def _bar(name: str, value: float, limit: float | None) -> str:
    """Return a value beside its limit: 0.8 of 2.0 mm."""
    if limit is None:
        return (f'<table><tr><td>{escape(name)}</td><td class="value">{format_error(value)}</td>'
                '</tr></table>')
    tone = 'good' if value <= limit else 'warn'
    share = min(100.0 * value / limit, 100.0)
    number = format_error(value).removesuffix(' mm')
    return (f'<table><tr><td>{escape(name)}</td><td class="value {tone}">{escape(number)} of '
            f'{format_error(limit)}</td></tr></table>'
            f'<div class="bar {tone}"><i style="width:{share:.0f}%"></i></div>')


def _number(values: Values, key: str) -> float | None:
    try:
        return float(values[key])
    except (KeyError, ValueError):
        return None


def _capitalized(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
