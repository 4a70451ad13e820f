# SPDX-License-Identifier: Apache-2.0
"""The table of the report: the numbers of a registration in millimetres."""

from __future__ import annotations

from collections.abc import Mapping

from gsdf_registration import __version__
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import quaternion_from_rotation

Rows = list[tuple[str, str]]
WHOLE_BONE = {'rms': 'RMS over the bone', 'max': 'maximum on the bone'}


def sections(result: RegistrationResult, about: Mapping[str, str]) -> dict[str, Rows]:
    """Return the rows (name, value) by heading, without unknown values; ``about`` comes last."""
    candidate = '' if result.success else 'Of the rejected candidate: '
    known = {
        'Pose of the bone in the tracker frame': _pose(result),
        candidate + 'Expected accuracy (predicted TRE)': _accuracy(result),
        candidate + 'Fit, NOT the accuracy': _fit(result),
        'Landmarks as measurements': [
            (fit.name, f'{fit.sentence}; its standard deviation is {_mm(fit.sigma_m)}')
            for fit in result.landmarks],
        'Points': [('received', str(result.received)), ('used', str(result.used)),
                   ('inliers', str(result.inliers))],
        'Time': [(name, f'{seconds:.2f} s') for name, seconds in result.timing_s.items()],
        'Inputs and version': [*about.items(), ('gsdf_registration', __version__)],
    }
    return {heading: rows for heading, rows in known.items() if rows}


def _pose(result: RegistrationResult) -> Rows:
    T = result.T_tracker_bone
    if T is None:
        return []
    position = ', '.join(f'{1e3 * value:.2f}' for value in T[:3, 3])
    quaternion = ', '.join(f'{value:.6f}' for value in quaternion_from_rotation(T[:3, :3]))
    return [('position x, y, z', f'{position} mm'), ('quaternion x, y, z, w', quaternion)]


def _accuracy(result: RegistrationResult) -> Rows:
    rows = [(WHOLE_BONE.get(name, f'at {name}'), _mm(value))
            for name, value in result.predicted_tre_m.items() if value is not None]
    if result.weakest_direction is not None:
        rows.append(('weakest direction', result.weakest_direction.sentence))
    if result.runner_up_ratio is not None:
        rows.append(('runner-up ratio', f'{result.runner_up_ratio:.2f}: cost of the best '
                     'alternative pose over that of this pose'))
    return rows


def _fit(result: RegistrationResult) -> Rows:
    known = {'residual RMS of inliers': result.residual_rms_m,
             'noise of a point (sigma)': result.sigma_m}
    return [(name, _mm(value)) for name, value in known.items() if value is not None]


def _mm(metres: float) -> str:
    return f'{1e3 * metres:.2f} mm'
