# SPDX-License-Identifier: Apache-2.0
"""
A result in a few readable lines.

The residual is not shown, because it is no measure of the accuracy (Fitzpatrick 2009).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array, angle_between, displacement
from gsdf_registration.field import Field

Row = tuple[str, str]       # name, value


def summary(result: RegistrationResult, frame_id: str = '', more: Sequence[Row] = ()) -> str:
    """
    Return the outcome, the pose and its expected accuracy as text.

    Parameters
    ----------
    result : of a registration
    frame_id : frame of the points; empty: not known
    more : rows to add

    """
    counts = counts_by_cause(result.rejected)
    points = [('points', f'{result.received} received, {result.used} used, '
               f'{result.inliers} inliers')] if result.received else []
    left_out = counts_by_cause(result.left_out)
    points += [('left out', left_out)] if left_out else []
    points += [('rejected', counts)] if counts else []
    T = result.T_tracker_bone
    if T is None:
        return _table(f'refused ({result.reason}): {result.message}', [*points, *more])
    frame = f' in frame "{frame_id}"' if frame_id else ''
    angles = Rotation.from_matrix(T[:3, :3]).as_euler('xyz', degrees=True)
    return _table(f'registered: {result.message}', [
        ('position', f'{_numbers(1e3 * T[:3, 3])} mm{frame}'),
        ('rotation', f'{_numbers(angles)} deg about the fixed axes x, y, z'),
        *points, *((f'landmark {fit.name}', fit.sentence) for fit in result.landmarks),
        ('predicted TRE', _predicted_tre(result)), *more])


def counts_by_cause(rejected: Mapping[str, int]) -> str:
    """Return the counts that are not zero, with their causes, as text."""
    return ', '.join(f'{count} {cause.replace("_", " ")}'
                     for cause, count in rejected.items() if count)


def true_error(result: RegistrationResult, field: Field, truth: Array) -> str:
    """
    Return the error of the pose as text: TRE over the surface of the bone, and rotation.

    Parameters
    ----------
    result, field : the registration and the bone
    truth : (4, 4) m, the true T_tracker_bone

    """
    T = result.T_tracker_bone
    if T is None:
        return 'none, there is no pose'
    points = field.surface_points.astype(np.float64)
    tre = 1e3 * displacement(T, truth, points)
    angle = np.degrees(angle_between(T[:3, :3], truth[:3, :3]))
    rms = np.sqrt(np.mean(tre**2))
    return (f'TRE over the bone {rms:.2f} mm RMS, {tre.max():.2f} mm maximum; '
            f'rotation {angle:.2f} deg')


def _table(title: str, rows: Sequence[Row]) -> str:
    return '\n'.join([title, *(f'  {name:<14} {value}' for name, value in rows)])


def _numbers(values: Array) -> str:
    return '  '.join(f'{value:.2f}' for value in values)


def _predicted_tre(result: RegistrationResult) -> str:
    known = {name: value for name, value in result.predicted_tre_m.items() if value is not None}
    return ', '.join(f'{name} {_millimetres(tre)}' for name, tre in known.items()) or 'not known'


def _millimetres(metres: float) -> str:
    return f'{1e3 * metres:.2f} mm' if metres >= 5e-6 else '< 0.01 mm'
