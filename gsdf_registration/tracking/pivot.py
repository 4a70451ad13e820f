# SPDX-License-Identifier: Apache-2.0
"""
Find the point of a moving body that stays still: the tip of a pivoted tool, the centre of a joint.

The point ``x`` (body frame) and its place ``c`` (tracker frame) satisfy ``R_i x + p_i = c`` for all
poses (R_i, p_i).  This is linear least squares ("algebraic one step", Yaniv 2015,
doi:10.1117/12.2081348), solved in closed form here.  Three things are added:

- A consensus over poses rejects wrong readings; steps of the residuals in time reveal a slip.
- Noise of the orientations shortens their mean and pulls ``x`` towards the origin of the body
  frame.  The noise is estimated from the residuals and the pull is corrected.
- The covariance comes from the residuals and allows for their correlation in time, so it remains
  valid when the point moves slowly, as a hip centre does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gsdf_registration.common.formatting import format_error
from gsdf_registration.common.rigid import Array, rms_error
from gsdf_registration.tracking.pivot_covariance import covariance_of, error_within
from gsdf_registration.tracking.pivot_inliers import (
    FEWEST,
    Away,
    consensus,
    longest_part,
    without_outliers,
)
from gsdf_registration.tracking.pivot_poses import (
    Clock,
    Poses,
    checked,
    fresh_rows,
    nearest_rotations,
    rigid_rows,
)
from gsdf_registration.tracking.pivot_task import JOINT, PIVOT, Task

__all__ = ['JOINT', 'PIVOT', 'FixedPoint', 'PivotReason', 'Task', 'calibrate_pivot',
           'find_fixed_point', 'find_joint_centre']

# share of the poses that must agree: anywhere, or in one part of which nearly all agree
SHARE, PART_SHARE, WITHIN_PART = 0.3, 0.15, 0.7
MAX_TURN_NOISE = np.radians(1.0) ** 2   # rad^2 per axis; bounds the estimate of the noise
STILL = np.radians(2.0)     # rad; a body that turns less stands still
WIDEST = 90.0           # deg; the advice never asks for more


class PivotReason(str, Enum):
    """Why a search for a fixed point ended; everything but `CONVERGED` is a refusal."""

    CONVERGED = 'converged'
    TOO_FEW_POSES = 'too_few_poses'
    STOOD_STILL = 'stood_still'
    ONE_AXIS = 'one_axis'
    RANGE_TOO_SMALL = 'range_too_small'
    SLIPPED = 'slipped'
    NOT_FIXED = 'not_fixed'
    WRONG_UNIT = 'wrong_unit'

    def __str__(self) -> str:
        """Return the lower-case word used in JSON and status."""
        return self.value


@dataclass(frozen=True)
class FixedPoint:
    """
    The point of a body that stays still, or why there is none; lengths in metres.

    point : (3,) body frame (a tip in the tool frame), or None when refused
    centre : (3,) its place in the tracker frame (the pivot), or None when refused
    covariance : (6, 6) of point and centre, or None when refused
    error : length of the error of ``point`` that is not exceeded with 95 % probability
    residual_rms : root mean square length of ``R x + p - c`` over the poses used
    angle_range : rad, largest angle between two of the poses used
    angles : (3,) rad, range of the rotation about the x, y and z axis of the body
    constraint : smallest eigenvalue of ``I - mean(R)' mean(R)``: 0 when the poses leave a direction
        of the point open, near 1 when they are spread over all orientations
    used : (n,) bool, the poses behind the answer, in the order given
    rejected : number of poses left out, by cause
    """

    reason: PivotReason
    message: str
    point: Array | None = None
    centre: Array | None = None
    covariance: Array | None = None
    error: float | None = None
    residual_rms: float | None = None
    angle_range: float | None = None
    angles: Array | None = None
    constraint: float | None = None
    used: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    rejected: dict[str, int] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether there is a point."""
        return self.reason is PivotReason.CONVERGED

    @property
    def rms_error(self) -> float | None:
        """Expected error of ``point``, RMS length, m; None if there is no point."""
        return None if self.covariance is None else rms_error(self.covariance[:3, :3])


def calibrate_pivot(T_tracker_tool: ArrayLike, stamps: ArrayLike | None = None,
                    task: Task = PIVOT) -> FixedPoint:
    """Return the tip of a tool that was turned in a divot: `find_fixed_point` for a pivot."""
    return find_fixed_point(T_tracker_tool, stamps, task)


def find_joint_centre(T_tracker_array: ArrayLike, stamps: ArrayLike | None = None,
                      task: Task = JOINT) -> FixedPoint:
    """Return the centre of the joint about which a limb with a reference array was swung."""
    return find_fixed_point(T_tracker_array, stamps, task)


def find_fixed_point(T_tracker_body: ArrayLike, stamps: ArrayLike | None,
                     task: Task) -> FixedPoint:
    """
    Return the point of a moving body that stays still.

    Parameters
    ----------
    T_tracker_body : (n, 4, 4) float, m
        Poses in the order of time, or in any order if there are stamps.  A pose that is not finite
        or not rigid is rejected and counted.
    stamps : (n,) float, s, or None
    task : Task
        `PIVOT`, `JOINT`, or one with other limits.

    Returns
    -------
    FixedPoint

    Raises
    ------
    ValueError
        If the shapes do not fit.

    """
    T, times = checked(T_tracker_body, stamps)
    rejected = dict.fromkeys(('not_finite', 'not_rigid', 'repeated', 'elsewhere', 'outlier'), 0)
    finite = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(times)
    valid = finite & rigid_rows(T)
    rejected['not_finite'] = int((~finite).sum())
    rejected['not_rigid'] = int((finite & ~valid).sum())
    order = np.flatnonzero(valid)
    order = order[np.argsort(times[order], kind='stable')]
    fresh = fresh_rows(T[order])
    rejected['repeated'] = int((~fresh).sum())
    order = order[fresh]
    if len(order) < FEWEST:
        still = len(fresh) >= FEWEST
        message = (f'the {task.body} stood still or the tracker repeats one reading, only '
                   f'{len(order)} of {len(T)} poses differ: {task.advice}' if still else
                   f'only {len(order)} of {len(T)} poses can be used, {FEWEST} are needed: '
                   f'{task.advice} for 10 s')
        return FixedPoint(PivotReason.STOOD_STILL if still else PivotReason.TOO_FEW_POSES, message,
                          used=np.zeros(len(T), dtype=bool), rejected=rejected)
    poses = Poses(nearest_rotations(T[order, :3, :3]), T[order, :3, 3])
    # stamps that do not advance give no times
    has_times = stamps is not None and float(np.ptp(times[order])) > 0.0
    clock = Clock(times[order], has_times)
    agreeing = consensus(poses, task.tolerance)
    part, away = longest_part(poses, agreeing, clock, task)
    inliers = without_outliers(poses, part, task)
    rejected['elsewhere'] = int((~part).sum())
    rejected['outlier'] = int((part & ~inliers).sum())
    used = np.zeros(len(T), dtype=bool)
    used[order[inliers]] = True
    return _answer(poses, inliers, away, used, rejected, task)


def _turn_noise(poses: Poses, point: Array, centre: Array) -> float:
    """
    Return the variance of the orientations, rad^2 per axis, as the residuals show it.

    In the body frame, noise of the orientation moves the point across its lever arm and noise of
    the position moves it along the arm too.
    """
    residuals = np.einsum('nij,ni->nj', poses.R, poses.places(point) - centre)
    square = float(point @ point)
    if square == 0.0:
        return 0.0
    S = residuals.T @ residuals / len(poses)
    along = float(point @ S @ point) / square
    return float(np.clip((np.trace(S) - 3.0 * along) / (2.0 * square), 0.0, MAX_TURN_NOISE))


def _answer(poses: Poses, inliers: NDArray[np.bool_], away: Away, used: NDArray[np.bool_],
            rejected: dict[str, int], task: Task) -> FixedPoint:
    """Return the point if it is determined well enough, else a refusal with what is missing."""
    if not _enough(inliers):
        found = away.clause if away.slipped else f'no point of the {task.body} stays still'
        message = (f'{found}: at most {inliers.sum()} of {len(poses)} poses agree within '
                   f'{1e3 * task.tolerance:.0f} mm; {task.advice}')
        return FixedPoint(PivotReason.SLIPPED if away.slipped else PivotReason.NOT_FIXED, message,
                          used=np.zeros_like(used), rejected=rejected)
    kept = poses[inliers]
    angle_range, angles = _angles(kept.R)
    constraints, directions = kept.constraints()
    point, centre = kept.solution()
    noise = _turn_noise(kept, point, centre)
    if constraints[0] > 10.0 * noise:
        point, centre = kept.solution(noise)
    else:
        noise = 0.0
    residuals = kept.places(point) - centre
    covariance = covariance_of(kept.R, residuals, noise)
    error = error_within(covariance[:3, :3])
    known: dict[str, Any] = {
        'residual_rms': float(np.sqrt((residuals**2).sum(axis=1).mean())), 'used': used,
        'angle_range': angle_range, 'angles': angles, 'constraint': float(constraints[0]),
        'rejected': rejected
    }
    worst = max(error, task.systematic / np.sqrt(max(constraints[0], 1e-12)))
    if worst <= task.limit:
        note = f'; {away.clause}; the {away.left} without it are used' if away.clause else ''
        message = (f'{task.point} found: expected error {format_error(error)} (95 %), '
                   f'{len(kept)} of {len(used)} poses used, which turn by '
                   f'{np.degrees(angle_range):.0f} deg{note}')
        return FixedPoint(PivotReason.CONVERGED, message, point, centre, covariance, error, **known)
    reason, message = _insufficient(angle_range, constraints, directions[:, 0], worst, task)
    if away.clause:
        message = f'{away.clause}, and in the {away.left} without it {message}'
    return FixedPoint(PivotReason.SLIPPED if away.slipped else reason, message, **known)


def _enough(inliers: NDArray[np.bool_]) -> bool:
    """Tell whether enough poses agree: of all, or of one part of the recording."""
    count = int(inliers.sum())
    if count < FEWEST:
        return False
    share = count / len(inliers)
    rows = np.flatnonzero(inliers)
    return share >= SHARE or (share >= PART_SHARE
                              and count >= WITHIN_PART * (rows[-1] - rows[0] + 1))


def _insufficient(angle_range: float, constraints: Array, axis: Array, error: float,
                  task: Task) -> tuple[PivotReason, str]:
    """Return why the poses do not determine the point, and what to do."""
    degrees = float(np.degrees(angle_range))
    if angle_range < STILL:
        return PivotReason.STOOD_STILL, (f'the {task.body} stood still, it turned by '
                                         f'{degrees:.1f} deg: {task.advice}')
    if constraints[0] < 0.05 * constraints[1]:
        name = f'[{axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}]'
        return PivotReason.ONE_AXIS, (
            f'the {task.body} turned by {degrees:.0f} deg, but only about its axis {name}, which '
            f'leaves the {task.point} open along it: {task.advice}')
    # the error falls as the angle rises, at least in proportion
    needed = min(5.0 * np.ceil(degrees * error / task.limit / 5.0), WIDEST)
    more = f'at least {needed:.0f} deg' if needed > degrees else 'further and for longer'
    return PivotReason.RANGE_TOO_SMALL, (
        f'the {task.body} turned by {degrees:.0f} deg, which leaves the {task.point} uncertain by '
        f'{format_error(error)} (limit {format_error(task.limit)}): turn it by {more} in all '
        'directions')


def _angles(R: Array) -> tuple[float, Array]:
    """Return the largest angle between two rotations (n, 3, 3), and the range about each axis."""
    U, _, Vt = np.linalg.svd(R.mean(axis=0))
    mean = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    some = R[np.unique(np.linspace(0, len(R) - 1, min(len(R), 400)).astype(int))].reshape(-1, 9)
    cosine = 0.5 * (float((some @ some.T).min()) - 1.0)
    turns = Rotation.from_matrix(mean.T @ R).as_rotvec()
    return float(np.arccos(np.clip(cosine, -1.0, 1.0))), np.ptp(turns, axis=0)
