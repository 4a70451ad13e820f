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
from gsdf_registration.common.rigid import MAX_COORDINATE, Array
from gsdf_registration.tracking.pivot_covariance import covariance_of, error_within

FEWEST = 10             # poses for an answer
# share of the poses that must agree: anywhere, or in one part of which nearly all agree
SHARE, PART_SHARE, WITHIN_PART = 0.3, 0.15, 0.7
TRIPLES = 500           # hypotheses of the consensus, half of them from a quarter of the recording
SCORED = 300            # poses each hypothesis is scored on
GATE = 5.0              # standard deviations; a longer residual is an outlier
STEP = 4.0              # standard deviations; a larger step of the residuals is a slip
PART = 0.05             # share of the poses; a slip leaves at least so many on both sides
CHI3_MEDIAN = 1.5382    # median length of a standard normal vector of three components
MAX_TURN_NOISE = np.radians(1.0) ** 2   # rad^2 per axis; bounds the estimate of the noise
FAR = 10.0              # tolerances; a point farther away has not slipped, it was elsewhere
STILL = np.radians(2.0)     # rad; a body that turns less stands still
WIDEST = 90.0           # deg; more is not asked of a user
NOT_RIGID = 1e-3        # tolerance of a rotation matrix


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
class Task:
    """
    What is looked for: the words of the messages, and the lengths that decide, m.

    point, body, slipped : what they are called, and what the point does when it leaves its place
    advice : how to move the body
    tolerance : the point may be this far from its place and still count as there
    limit : the largest acceptable error of the point (95 %)
    systematic : an error of the tracked position that varies with the orientation, as a distorted
        volume or a pelvis that follows the leg causes.  It does not show in the residuals, and
        moves the point by up to ``systematic / sqrt(constraint)``, see `FixedPoint.constraint`.
    """

    point: str
    body: str
    slipped: str
    advice: str
    tolerance: float
    limit: float
    systematic: float


PIVOT = Task('tip', 'tool', 'slipped', 'keep the tip in the divot and tilt the tool to all sides',
             tolerance=0.005, limit=0.001, systematic=0.0001)
JOINT = Task('joint centre', 'limb', 'moved',
             'hold the other bone still and swing the limb to all sides',
             tolerance=0.015, limit=0.005, systematic=0.0005)


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
    T, times = _checked(T_tracker_body, stamps)
    rejected = dict.fromkeys(('not_finite', 'not_rigid', 'repeated', 'elsewhere', 'outlier'), 0)
    finite = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(times)
    valid = finite & _rigid(T)
    rejected['not_finite'] = int((~finite).sum())
    rejected['not_rigid'] = int((finite & ~valid).sum())
    order = np.flatnonzero(valid)
    order = order[np.argsort(times[order], kind='stable')]
    fresh = _fresh(T[order])
    rejected['repeated'] = int((~fresh).sum())
    order = order[fresh]
    if len(order) < FEWEST:
        return FixedPoint(
            PivotReason.TOO_FEW_POSES,
            f'only {len(order)} of {len(T)} poses can be used, {FEWEST} are needed: '
            f'{task.advice} for 10 s', used=np.zeros(len(T), dtype=bool), rejected=rejected)
    poses = _Poses(_nearest_rotations(T[order, :3, :3]), T[order, :3, 3])
    # stamps that do not advance give no times
    has_times = stamps is not None and float(np.ptp(times[order])) > 0.0
    clock = _Clock(times[order], has_times)
    agreeing = _consensus(poses, task.tolerance)
    part, away = _longest_part(poses, agreeing, clock, task)
    inliers = _without_outliers(poses, part, task)
    rejected['elsewhere'] = int((~part).sum())
    rejected['outlier'] = int((part & ~inliers).sum())
    used = np.zeros(len(T), dtype=bool)
    used[order[inliers]] = True
    return _answer(poses, inliers, away, used, rejected, task)


@dataclass(frozen=True)
class _Poses:
    """Rotations (n, 3, 3) and positions (n, 3), m, in the order of time."""

    R: Array
    p: Array

    def __len__(self) -> int:
        return len(self.p)

    def __getitem__(self, rows: NDArray) -> _Poses:
        return _Poses(self.R[rows], self.p[rows])

    def places(self, point: Array) -> Array:
        """Return where ``point`` (3,), body frame, was at each pose (n, 3), tracker frame."""
        return np.asarray(self.R @ point + self.p)

    def solution(self, turn_noise: float = 0.0) -> tuple[Array, Array]:
        """
        Return point (3,) and centre (3,) by least squares.

        ``turn_noise``, rad^2 per axis, is the variance of the orientations: it makes the mean of
        the measured rotations shorter than the mean of the true ones by the factor 1 - turn_noise.
        """
        R = self.R.mean(axis=0) / (1.0 - turn_noise)
        p = self.p.mean(axis=0)
        turned = np.einsum('nij,ni->j', self.R, self.p) / len(self) / (1.0 - turn_noise)
        point = np.linalg.lstsq(np.eye(3) - R.T @ R, R.T @ p - turned, rcond=1e-12)[0]
        return point, R @ point + p

    def constraints(self) -> tuple[Array, Array]:
        """Return how well the poses determine each direction of the point, rising; directions."""
        R = self.R.mean(axis=0)
        values, vectors = np.linalg.eigh(np.eye(3) - R.T @ R)
        return np.maximum(values, 0.0), vectors


@dataclass(frozen=True)
class _Away:
    """When the point was not in its place: a clause, empty if never, and whether it slipped."""

    clause: str = ''
    slipped: bool = False
    left: str = ''      # how much of the recording is without it


@dataclass(frozen=True)
class _Clock:
    """When each pose was recorded, in words."""

    times: Array
    has_stamps: bool

    def after(self, i: int) -> str:
        """Return the time of pose ``i`` as a user counts it."""
        return f'{self.times[i] - self.times[0]:.1f} s' if self.has_stamps else f'{i} poses'

    def duration(self, rows: NDArray) -> str:
        """Return how long a part of the recording is."""
        if not self.has_stamps:
            return f'{len(rows)} poses'
        return f'{self.times[rows[-1]] - self.times[rows[0]]:.1f} s'


def _checked(T: ArrayLike, stamps: ArrayLike | None) -> tuple[Array, Array]:
    """Return poses (n, 4, 4) and times (n,): the stamps, or the numbers of the poses."""
    poses = np.asarray(T, dtype=np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise ValueError(f'poses must have the shape (n, 4, 4), not {poses.shape}')
    times = np.arange(len(poses), dtype=np.float64) if stamps is None else np.asarray(
        stamps, dtype=np.float64)
    if times.shape != (len(poses),):
        raise ValueError(f'{len(poses)} poses need {len(poses)} stamps, not {times.shape}')
    return poses, times


def _rigid(T: Array) -> NDArray[np.bool_]:
    """Return which of the poses (n, 4, 4) are rigid motions within the reach of a tracker."""
    with np.errstate(invalid='ignore', over='ignore'):
        R = T[:, :3, :3]
        skewed = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
        proper = np.linalg.det(R) > 0.0
        last = np.abs(T[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
        near = np.abs(T[:, :3, 3]).max(axis=1, initial=0.0) < MAX_COORDINATE
        return np.asarray((skewed <= NOT_RIGID) & proper & (last <= NOT_RIGID) & near)


def _fresh(T: Array) -> NDArray[np.bool_]:
    """Return which poses (n, 4, 4) are not the one before again: a repetition is no reading."""
    fresh = np.ones(len(T), dtype=bool)
    fresh[1:] = (T[1:] != T[:-1]).any(axis=(1, 2))
    return fresh


def _nearest_rotations(R: Array) -> Array:
    """Return the rotations nearest to ``R`` (n, 3, 3), which are close to rotations."""
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt


def _consensus(poses: _Poses, tolerance: float) -> NDArray[np.bool_]:
    """
    Return the poses at which one point is within ``tolerance`` of one place.

    Every triple of poses determines a point and its place.  The best of many random triples has
    the smallest sum of squared distances, each limited to the tolerance (MSAC, Torr and Zisserman
    2000).  It is refined on the poses that agree with it.
    """
    n = len(poses)
    triples = _triples(n)
    R, p = poses.R[triples], poses.p[triples]
    mean_R, mean_p = R.mean(axis=1), p.mean(axis=1)
    M = np.eye(3) * (1.0 + 1e-9) - np.swapaxes(mean_R, 1, 2) @ mean_R
    rhs = np.einsum('kij,ki->kj', mean_R, mean_p) - np.einsum('ktij,kti->kj', R, p) / 3.0
    points = np.linalg.solve(M, rhs[..., None])[..., 0]
    centres = np.einsum('kij,kj->ki', mean_R, points) + mean_p
    points = np.vstack([points, poses.solution()[0]])
    centres = np.vstack([centres, poses.solution()[1]])

    scored = poses[np.unique(np.linspace(0, n - 1, min(n, SCORED)).astype(int))]
    costs = [np.minimum(((scored.places(x) - c) ** 2).sum(axis=1), tolerance**2).sum()
             for x, c in zip(points, centres)]
    best, best_cost = np.zeros(n, dtype=bool), np.inf
    for k in np.argsort(costs, kind='stable')[:5]:
        agreeing, cost = _refined(poses, points[k], centres[k], tolerance)
        if cost < best_cost:
            best, best_cost = agreeing, cost
    return best


def _triples(n: int) -> NDArray[np.intp]:
    """Return triples (k, 3) of different rows; a quarter of the rows is more often without slip."""
    rng = np.random.default_rng(0)
    starts = rng.random(TRIPLES) * 0.75 * n
    lengths = np.full(TRIPLES, 0.25 * n)
    starts[::2], lengths[::2] = 0.0, n
    # three different of ten strata
    strata = np.argsort(rng.random((TRIPLES, 10)), axis=1)[:, :3]
    shares = (strata + rng.random(strata.shape)) / 10.0
    return np.minimum((starts[:, None] + shares * lengths[:, None]).astype(np.intp), n - 1)


def _refined(poses: _Poses, point: Array, centre: Array,
             tolerance: float) -> tuple[NDArray[np.bool_], float]:
    """Return the poses that agree with a point and place after refinement, and their cost."""
    agreeing = np.zeros(len(poses), dtype=bool)
    for _ in range(20):
        squares = ((poses.places(point) - centre) ** 2).sum(axis=1)
        before, agreeing = agreeing, squares < tolerance**2
        if agreeing.sum() < FEWEST or (before == agreeing).all():
            break
        point, centre = poses[agreeing].solution()
    return agreeing, float(np.minimum(squares, tolerance**2).sum())


def _longest_part(poses: _Poses, agreeing: NDArray[np.bool_], clock: _Clock,
                  task: Task) -> tuple[NDArray[np.bool_], _Away]:
    """
    Return the poses during which the point stayed in one place, and when it did not.

    A slip by more than the tolerance shows as a run of poses that do not agree; a smaller one as a
    step of the residuals in time.
    """
    rows = np.flatnonzero(agreeing)
    if len(rows) < FEWEST:
        return agreeing, _Away()
    fewest = max(FEWEST, round(PART * len(poses)))
    run = _longest_run(~agreeing)
    clause, slipped = '', False
    if len(run) >= fewest:
        clause, slipped = _described(poses, rows, run, clock, task)
    while len(rows) >= 2 * fewest:
        i, step, sigma = _largest_step(poses[rows], fewest)
        if step <= max(STEP * sigma, 1e-3 * task.tolerance):
            break
        clause, slipped = _slip(task, step, clock.after(int(rows[i]))), True
        rows = rows[:i] if i > len(rows) - i else rows[i:]
    part = np.zeros(len(poses), dtype=bool)
    part[rows] = True
    return part, _Away(clause, slipped, clock.duration(rows))


def _described(poses: _Poses, rows: NDArray[np.intp], run: NDArray[np.intp], clock: _Clock,
               task: Task) -> tuple[str, bool]:
    """Return what the point did during a run of poses, and whether it slipped."""
    point, centre = poses[rows].solution()
    places = poses[run].places(point)
    where = np.median(places, axis=0)
    distance = float(np.linalg.norm(where - centre))
    stayed = float(np.median(np.linalg.norm(places - where, axis=1))) < task.tolerance
    if stayed and distance < FAR * task.tolerance:
        return _slip(task, distance, clock.after(int(run[0] if run[0] > 0 else run[-1] + 1))), True
    return f'the {task.point} was not in its place for {clock.duration(run)}', False


def _slip(task: Task, distance: float, when: str) -> str:
    return f'the {task.point} {task.slipped} by {1e3 * distance:.1f} mm after {when}'


def _longest_run(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the rows of the longest run of true values; single false ones do not interrupt it."""
    wide = mask.copy()
    wide[1:-1] |= mask[:-2] & mask[2:]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wide, [False]]).astype(int)))
    if not len(edges):
        return np.zeros(0, dtype=np.intp)
    starts, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - starts))
    return np.arange(starts[k], ends[k])


def _largest_step(poses: _Poses, fewest: int) -> tuple[int, float, float]:
    """
    Return where the place of the point changes most, by how much, and the noise per axis, m.

    For each possible row, one point and two places are fitted by least squares: one place before
    the row and one from it on.  The best of some 100 rows is refined among its neighbours.
    """
    last = len(poses) - fewest
    rows = np.unique(np.linspace(fewest, last, 100).astype(int))
    spacing = int(np.diff(rows).max(initial=1))
    sums = np.cumsum(poses.R, axis=0), np.cumsum(poses.p, axis=0)
    turned = np.einsum('nij,ni->j', poses.R, poses.p)
    row = min(rows.tolist(), key=lambda i: _two_places(poses, i, sums, turned)[1])
    near = range(max(row - spacing, fewest), min(row + spacing, last) + 1)
    row = min(near, key=lambda i: _two_places(poses, i, sums, turned)[1])
    step, sigma = _two_places(poses, row, sums, turned)
    return row, step, sigma


def _two_places(poses: _Poses, i: int, sums: tuple[Array, Array],
                turned: Array) -> tuple[float, float]:
    """Return the distance of two places, before row ``i`` and from it on, and the noise, m."""
    n = len(poses)
    R1, p1 = (each[i - 1] / i for each in sums)
    R2, p2 = ((each[-1] - each[i - 1]) / (n - i) for each in sums)
    M = n * np.eye(3) - i * R1.T @ R1 - (n - i) * R2.T @ R2
    rhs = i * R1.T @ p1 + (n - i) * R2.T @ p2 - turned
    point = np.linalg.lstsq(M, rhs, rcond=1e-9)[0]
    c1, c2 = R1 @ point + p1, R2 @ point + p2
    residuals = poses.places(point)
    residuals[:i] -= c1
    residuals[i:] -= c2
    return float(np.linalg.norm(c2 - c1)), float(np.sqrt((residuals**2).sum() / (3 * n)))


def _without_outliers(poses: _Poses, part: NDArray[np.bool_], task: Task) -> NDArray[np.bool_]:
    """Return the poses of a part whose residuals are not far longer than most."""
    inliers = part.copy()
    if inliers.sum() < FEWEST:
        return inliers
    for _ in range(20):
        point, centre = poses[inliers].solution()
        lengths = np.linalg.norm(poses.places(point) - centre, axis=1)
        sigma = max(float(np.median(lengths[inliers])) / CHI3_MEDIAN, 1e-4 * task.tolerance)
        before, inliers = inliers, part & (lengths < min(GATE * sigma, task.tolerance))
        if inliers.sum() < FEWEST or (before == inliers).all():
            break
    return inliers


def _turn_noise(poses: _Poses, point: Array, centre: Array) -> float:
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


def _answer(poses: _Poses, inliers: NDArray[np.bool_], away: _Away, used: NDArray[np.bool_],
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
