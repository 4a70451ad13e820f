# SPDX-License-Identifier: Apache-2.0
"""
A result in a few readable lines.

The residual is not shown, because it is no measure of the accuracy (Fitzpatrick 2009).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array, angle_between, displacement, rms
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


class TrueError(NamedTuple):
    """
    How far a pose is from the true one.

    rms_m, max_m : float, m, TRE over the surface of the bone
    rotation : float, rad
    """

    rms_m: float
    max_m: float
    rotation: float

    def __str__(self) -> str:
        """Return the error as text."""
        return (f'TRE over the bone {1e3 * self.rms_m:.2f} mm RMS, {1e3 * self.max_m:.2f} mm '
                f'maximum; rotation {np.degrees(self.rotation):.2f} deg')


def true_error(result: RegistrationResult, field: Field, truth: Array) -> TrueError | None:
    """
    Return the error of the pose; None without a pose.

    Parameters
    ----------
    result, field : the registration and the bone
    truth : (4, 4) m, the true T_tracker_bone

    """
    T = result.T_tracker_bone
    if T is None:
        return None
    tre = displacement(T, truth, field.surface_points.astype(np.float64))
    return TrueError(rms(tre), float(tre.max()), float(angle_between(T[:3, :3], truth[:3, :3])))


def _table(title: str, rows: Sequence[Row]) -> str:
    return '\n'.join([title, *(f'  {name:<14} {value}' for name, value in rows)])


def _numbers(values: Array) -> str:
    return '  '.join(f'{value:.2f}' for value in values)


def _predicted_tre(result: RegistrationResult) -> str:
    known = {name: value for name, value in result.predicted_tre_m.items() if value is not None}
    return ', '.join(f'{name} {_millimetres(tre)}' for name, tre in known.items()) or 'not known'


def _millimetres(metres: float) -> str:
    return f'{1e3 * metres:.2f} mm' if metres >= 5e-6 else '< 0.01 mm'
