# SPDX-License-Identifier: Apache-2.0
"""Check the inputs of a registration before it starts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common import rigid
from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.formatting import format_count, format_length
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError, Reason, Refusal, as_numbers
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.landmarks import pose_from_landmarks
from gsdf_registration.registration.point_selection import PointSelection

# The extent of the points over that of the bone: outside this range the unit is wrong, by a factor
# of a thousand, even if the whole bone is exposed
MIN_EXTENT_RATIO, MAX_EXTENT_RATIO = 0.002, 20.0


def check_points(points: Array, limits: LimitsConfig) -> None:
    """Check the points (n, 3), metres, tracker frame; raise `Refusal` if they are not valid."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f'points must be an (n, 3) array, but their shape is {points.shape}')
    # NaN, infinite, or so large that it marks a missing value
    bad = int((~(np.abs(points) < rigid.MAX_COORDINATE).all(axis=1)).sum())
    if bad:
        raise InputError(
            f'not finite: {bad} of {len(points)} points; remove them before the registration')
    if len(points) < limits.min_points:
        raise Refusal(
            Reason.TOO_FEW_POINTS,
            f'too few points: {len(points)}, {limits.min_points} are needed; '
            'drag the probe over more of the bone')


def check_selection(selection: PointSelection, points: Array, field: Field,
                    limits: LimitsConfig) -> None:
    """
    Check the extent and the number of the selected points.

    The extent is measured between the 5th and the 95th percentile, as there may be outliers.

    Raises
    ------
    Refusal
        If the points cannot be registered.

    """
    used = len(selection.rows)
    spread = selection.positions if used >= limits.min_points else points
    extent = float(np.ptp(np.percentile(spread, [5.0, 95.0], axis=0), axis=0).max())
    plausible = MIN_EXTENT_RATIO * field.extent < extent < MAX_EXTENT_RATIO * field.extent
    if extent > 0.0 and not plausible:
        raise Refusal(
            Reason.WRONG_UNIT,
            f'the points span {format_length(extent)} and the bone {format_length(field.extent)}; '
            'check the unit of the points (m or mm) and that the probe tip was moved')
    if extent < limits.min_extent:
        raise Refusal(
            Reason.REGION_TOO_SMALL,
            f'the points span only {format_length(extent)}, {format_length(limits.min_extent)} '
            'are needed; drag the probe over more of the bone')
    if used < limits.min_points:
        touches = format_count(len(selection.touches), 'touch', 'touches')
        raise Refusal(
            Reason.TOO_FEW_POINTS,
            f'too few points: {selection.strokes} on strokes and {touches}, {limits.min_points} '
            'are needed; drag the probe over the bone, or hold it still for half a second at each '
            'of many places')


def initial_guess(landmarks: Landmarks | None,
                  T_tracker_bone: ArrayLike | None) -> Array | None:
    """
    Return the pose T_bone_tracker (4, 4) to search around, or None without one.

    Parameters
    ----------
    landmarks : Landmarks, optional
    T_tracker_bone : (4, 4) float, metres, optional
        Takes precedence over the landmarks.

    Raises
    ------
    InputError
        If it is not a rigid motion, or if there are landmarks, none of which is a measurement,
        that do not determine one.

    """
    if T_tracker_bone is not None:
        T_tracker_bone = as_numbers(T_tracker_bone, 'the initial pose')
        if not rigid.is_rigid(T_tracker_bone):
            raise InputError(
                'the initial pose is not a 4x4 rigid motion (rotation, translation in metres)')
        return rigid.inverse(T_tracker_bone)
    if landmarks is None or not len(landmarks):
        return None
    try:
        return rigid.inverse(pose_from_landmarks(landmarks.model, landmarks.touched)[0])
    except InputError:
        if len(landmarks.measured):     # a joint centre helps without an initial guess, too
            return None
        raise
