# SPDX-License-Identifier: Apache-2.0
"""A result in a few readable lines; the residual is not among them: it is not the accuracy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from gsdf_registration.cli.common import counts_by_cause
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array, angle_between, displacement
from gsdf_registration.field import Field


def summary(result: RegistrationResult,
            frame_id: str = '',
            rejected: Mapping[str, int] | None = None) -> str:
    """
    Return the outcome: what was decided, where the bone is, how well that is known.

    ``rejected`` holds the points that were not believed, by cause.
    """
    counts = counts_by_cause(rejected or {})
    rows = [('not believed', counts)] if counts else []
    T = result.T_tracker_bone
    if T is None:
        return _table(f'refused ({result.reason}): {result.message}', rows)
    return _table(f'registered: {result.message}', [
        ('position', _numbers(1e3 * T[:3, 3]) + ' mm' +
         (f' in frame "{frame_id}"' if frame_id else '')),
        ('rotation', _numbers(Rotation.from_matrix(T[:3, :3]).as_euler('xyz', degrees=True))
         + ' deg about the fixed axes x, y, z'),
        ('points', f'{result.received} received, {result.used} used, {result.inliers} inliers'),
        *rows,
        ('predicted TRE', _tre(result)),
    ])


def true_error(result: RegistrationResult, field: Field, truth: Array) -> str:
    """
    Return how far the pose is from the true one, in one line.

    TRE over the whole surface of the bone.
    """
    T = result.T_tracker_bone
    if T is None:
        return 'none, there is no pose'
    points = field.surface_points.astype(np.float64)
    tre = 1e3 * displacement(T, truth, points)
    angle = np.degrees(angle_between(T[:3, :3], truth[:3, :3]))
    rms = np.sqrt(np.mean(tre**2))
    return (f'TRE over the bone {rms:.2f} mm RMS, {tre.max():.2f} mm at most; '
            f'rotation {angle:.2f} deg')


def _table(title: str, rows: list[tuple[str, str]]) -> str:
    return '\n'.join([title, *(f'  {name:<14} {value}' for name, value in rows)])


def _numbers(values: Array) -> str:
    return '  '.join(f'{value:.2f}' for value in values)


def _tre(result: RegistrationResult) -> str:
    known = {name: value for name, value in result.predicted_tre_m.items() if value is not None}
    return ', '.join(f'{name} {1e3 * value:.2f} mm' for name, value in known.items()) or 'not known'
