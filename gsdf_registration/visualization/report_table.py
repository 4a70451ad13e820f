# SPDX-License-Identifier: Apache-2.0
"""The tables of the report: the numbers of a registration in millimetres."""

from __future__ import annotations

import platform

import numba
import numpy as np
import scipy

from gsdf_registration import __version__
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import inverse, quaternion_from_rotation, transform
from gsdf_registration.registration.stroke_report import report_strokes
from gsdf_registration.visualization.report_content import ReportContent

Rows = list[tuple[str, str]]
WHOLE_BONE = {'rms': 'RMS over the bone', 'max': 'maximum on the bone'}
TIMES = {'search': 'search', 'solve': 'solve', 'total': 'registration in total'}


def sections(content: ReportContent) -> dict[str, Rows]:
    """Return the rows (name, value) by heading, without unknown values."""
    result = content.result
    candidate = '' if result.success else 'Of the rejected candidate: '
    known = {
        'Pose of the bone in the tracker frame': _pose(result),
        candidate + 'Expected accuracy (predicted TRE)': _accuracy(result),
        candidate + 'Fit, NOT the accuracy': _fit(result),
        'Landmarks': _landmarks(content),
        'Verification points, not used in the fit': _verifications(content),
        'Strokes': _strokes(content),
        'Samples: what was received': counts(content),
        'Time, without compilation': [(TIMES.get(name, name), f'{seconds:.2f} s')
                                      for name, seconds in result.timing_s.items()],
        'Parameters that differ from the defaults': changed_parameters(content.config) or [
            ('all', 'are the defaults')],
        'Inputs and versions': [*content.about.items(), *_versions()],
    }
    return {heading: rows for heading, rows in known.items() if rows}


def counts(content: ReportContent) -> Rows:
    """Return what became of every sample; the last column adds up to the samples received."""
    result = content.result
    parts = {'on the bone': result.inliers,
             'off the bone (outliers)': result.used - result.inliers,
             **{_words(cause): number for cause, number in result.left_out.items()},
             **{f'rejected: {_words(cause)}': number
                for cause, number in result.rejected.items()}}
    rest = result.received - sum(parts.values())
    if rest > 0:
        parts['not explained'] = rest
    rows = [(name, str(number)) for name, number in parts.items() if number]
    return [*rows, ('received', str(sum(parts.values())))] if rows else []


def changed_parameters(config: Config) -> Rows:
    """Return the parameters with another value than by default, except the file of the model."""
    default = Config().flat()
    return [(name, setting(value)) for name, value in config.flat().items()
            if value != default[name] and name != 'model.path']


def whole_bone(name: str) -> str:
    """Return the name of an entry of ``predicted_tre_m`` in words."""
    return WHOLE_BONE.get(name, f'at {name}')


def mm(metres: float) -> str:
    """Return a length in mm with two decimals."""
    return f'{1e3 * metres:.2f} mm'


def _pose(result: RegistrationResult) -> Rows:
    T = result.T_tracker_bone
    if T is None:
        return []
    position = ', '.join(f'{1e3 * value:.2f}' for value in T[:3, 3])
    quaternion = ', '.join(f'{value:.6f}' for value in quaternion_from_rotation(T[:3, :3]))
    return [('position x, y, z', f'{position} mm'), ('quaternion x, y, z, w', quaternion)]


def _accuracy(result: RegistrationResult) -> Rows:
    rows = [(whole_bone(name), mm(value)) for name, value in result.predicted_tre_m.items()
            if value is not None]
    if result.zone is not None:
        rows += [(f'95 % bound at {name}', mm(value)) for name, value in result.zone.p95_m.items()]
        rows += [('95 % bound within 100 mm', mm(result.zone.touched_p95_m)),
                 ('95 % bound on the whole bone', mm(result.zone.bone_p95_m))]
    if result.weakest_direction is not None:
        rows.append(('weakest direction', result.weakest_direction.sentence))
    if result.runner_up_ratio is not None:
        rows.append(('runner-up ratio', f'{result.runner_up_ratio:.2f}: cost of the best '
                     'alternative pose over that of this pose'))
    return rows


def _fit(result: RegistrationResult) -> Rows:
    known = {'residual RMS of inliers': result.residual_rms_m,
             'noise of a point (sigma)': result.sigma_m}
    return [(name, mm(value)) for name, value in known.items() if value is not None]


def _landmarks(content: ReportContent) -> Rows:
    fits = {fit.name: f'{fit.sentence}; its standard deviation is {mm(fit.sigma_m)}'
            for fit in content.result.landmarks}
    landmarks = content.landmarks
    if content.pose is None:
        return [(name, 'touched') for name in landmarks.names]
    touched = transform(inverse(content.pose), landmarks.touched)
    return [(name, fits.get(name) or f'{mm(float(np.linalg.norm(at - model)))} from its place; '
             'only an initial guess') for name, at, model in zip(
                 landmarks.names, touched, landmarks.model)] + [
        (name, text) for name, text in fits.items() if name not in landmarks.names]


def _verifications(content: ReportContent) -> Rows:
    limit = content.config.limits.verification
    return [(each.name, f'{1e3 * each.distance_m:+.2f} mm from the surface, '
             f'{"within" if abs(each.distance_m) <= limit else "BEYOND"} {mm(limit)}'
             + ('' if each.moved_m is None else
                f'; moved {mm(each.moved_m)} since it was first touched'))
            for each in content.verifications]


def _strokes(content: ReportContent) -> Rows:
    if not content.timed or content.result.residuals_m is None:
        return []
    return [(f'stroke {each.number}', each.sentence.partition(': ')[2])
            for each in report_strokes(content.points, content.residuals, content.weights)]


def _versions() -> Rows:
    return [('gsdf_registration', __version__), ('Python', platform.python_version()),
            ('numpy', np.__version__), ('scipy', scipy.__version__), ('numba', numba.__version__)]


def setting(value: object) -> str:
    """Return the value of a setting as text."""
    if isinstance(value, list):
        return ', '.join(map(setting, value))
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def _words(cause: str) -> str:
    return cause.replace('_', ' ')
