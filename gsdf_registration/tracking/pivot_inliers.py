# SPDX-License-Identifier: Apache-2.0
"""The poses during which a point of a body stayed in one place: no wrong readings, no slips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.rigid import Array
from gsdf_registration.tracking.pivot_covariance import autocovariance
from gsdf_registration.tracking.pivot_poses import Clock, Poses
from gsdf_registration.tracking.pivot_task import Task

FEWEST = 10             # poses for an answer
TRIPLES = 500           # hypotheses of the consensus, half of them from a quarter of the recording
SCORED = 300            # poses each hypothesis is scored on
GATE = 5.0              # standard deviations; a longer residual is an outlier
STEP = 6.0              # standard errors; a larger step of the residuals is a slip
INDEPENDENT = 50.0      # residuals; with fewer their correlation is not known well
SLOW_STEP = 4.0         # standard deviations; a larger step is a slip all the same
PART = 0.05             # share of the poses; a slip leaves at least so many on both sides
CHI3_MEDIAN = 1.5382    # median length of a standard normal vector of three components
FAR = 10.0              # tolerances; a point farther away has not slipped, it was elsewhere


@dataclass(frozen=True)
class Away:
    """When the point was not in its place: a clause, empty if never, and whether it slipped."""

    clause: str = ''
    slipped: bool = False
    left: str = ''      # how much of the recording is without it


def consensus(poses: Poses, tolerance: float) -> NDArray[np.bool_]:
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
    offsets = np.einsum('nij,kj->nik', scored.R, points) + scored.p[..., None] - centres.T
    costs = np.minimum((offsets**2).sum(axis=1), tolerance**2).sum(axis=0)
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


def _refined(poses: Poses, point: Array, centre: Array,
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


def longest_part(poses: Poses, agreeing: NDArray[np.bool_], clock: Clock,
                  task: Task) -> tuple[NDArray[np.bool_], Away]:
    """
    Return the poses during which the point stayed in one place, and when it did not.

    A slip by more than the tolerance shows as a run of poses that do not agree; a smaller one as a
    step of the residuals in time.
    """
    rows = np.flatnonzero(agreeing)
    if len(rows) < FEWEST:
        return agreeing, Away()
    fewest = max(FEWEST, round(PART * len(poses)))
    run = _longest_run(~agreeing)
    clause, slipped = '', False
    if len(run) >= fewest:
        clause, slipped = _described(poses, rows, run, clock, task)
    while len(rows) >= 2 * fewest:
        i, step, error = _largest_step(poses[rows], fewest)
        if step <= max(STEP * error, 1e-3 * task.tolerance):
            break
        clause, slipped = _slip(task, step, clock.after(int(rows[i]))), True
        rows = rows[:i] if i > len(rows) - i else rows[i:]
    part = np.zeros(len(poses), dtype=bool)
    part[rows] = True
    return part, Away(clause, slipped, clock.duration(rows))


def _described(poses: Poses, rows: NDArray[np.intp], run: NDArray[np.intp], clock: Clock,
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


def _largest_step(poses: Poses, fewest: int) -> tuple[int, float, float]:
    """
    Return where the place of the point changes most, by how much, and the standard error, m.

    For each possible row, one point and two places are fitted by least squares: one place before
    the row and one from it on.  The best of some 100 rows is refined among its neighbours.  The
    standard error allows for the correlation of the residuals in time.
    """
    n = len(poses)
    last = n - fewest
    rows = np.unique(np.linspace(fewest, last, 100).astype(int))
    spacing = int(np.diff(rows).max(initial=1))
    sums = np.cumsum(poses.R, axis=0), np.cumsum(poses.p, axis=0)
    turned = np.einsum('nij,ni->j', poses.R, poses.p)

    squares = float((poses.p**2).sum())

    def square(i: int) -> float:
        """Return the sum of the squared residuals; rotations keep the length of the point."""
        point, c1, c2 = _two_places(n, i, sums, turned)
        return float(n * point @ point + 2.0 * point @ turned + squares - i * c1 @ c1
                     - (n - i) * c2 @ c2)
    row = min(rows.tolist(), key=square)
    row = min(range(max(row - spacing, fewest), min(row + spacing, last) + 1), key=square)
    point, c1, c2 = _two_places(n, row, sums, turned)
    residuals = poses.places(point)
    residuals[:row] -= c1
    residuals[row:] -= c2
    return row, float(np.linalg.norm(c2 - c1)), _standard_error(residuals, row)


def _standard_error(residuals: Array, i: int) -> float:
    """Return the standard error of the step at row ``i``, m per axis."""
    n = len(residuals)
    covariance = autocovariance(residuals)
    if not covariance[0] > 0.0:
        return 0.0
    repeats = 1.0 + 2.0 * float(covariance[1:].sum() / covariance[0])
    error = np.sqrt(covariance[0] * repeats * (1.0 / i + 1.0 / (n - i)))
    if n / repeats < INDEPENDENT:
        # slow motion of the point looks like a step: only a large one is a slip
        error = max(error, np.sqrt(covariance[0]) * SLOW_STEP / STEP)
    return float(error)


def _two_places(n: int, i: int, sums: tuple[Array, Array],
                turned: Array) -> tuple[Array, Array, Array]:
    """Return the point, its place before row ``i`` of ``n``, and its place from it on, (3,), m."""
    R1, p1 = (each[i - 1] / i for each in sums)
    R2, p2 = ((each[-1] - each[i - 1]) / (n - i) for each in sums)
    M = n * np.eye(3) - i * R1.T @ R1 - (n - i) * R2.T @ R2
    rhs = i * R1.T @ p1 + (n - i) * R2.T @ p2 - turned
    point = np.linalg.lstsq(M, rhs, rcond=1e-9)[0]
    return point, R1 @ point + p1, R2 @ point + p2


def without_outliers(poses: Poses, part: NDArray[np.bool_], task: Task) -> NDArray[np.bool_]:
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
