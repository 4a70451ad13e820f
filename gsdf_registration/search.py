# SPDX-License-Identifier: Apache-2.0
"""
The pose with no first guess, and the other poses that fit nearly as well.

Many starts, each pulled in by a few Gauss-Newton steps of ever narrower robust weights, on few
points and the coarse field at first; only the best go on to more points and the fine field.
Rotations from the super-Fibonacci spiral (Alexa, CVPR 2022), places spread over the surface.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from gsdf_registration import rigid
from gsdf_registration.config import SearchConfig
from gsdf_registration.density import spread_sample, thinned
from gsdf_registration.field import Field
from gsdf_registration.field.sample import sample, sample_coarse
from gsdf_registration.result import Reason, Refusal
from gsdf_registration.rigid import Array
from gsdf_registration.solver.gauss_newton import kernel, solve_cholesky, update

CHUNK = 64      # candidates a task: small enough to share evenly and to stop soon


@dataclass(frozen=True)
class Stage:
    """One sieve: points used, scale of each step (share of the reach), the field, how many pass."""

    points: int
    scales: tuple[float, ...]
    coarse: bool
    survivors: int


FIRST = Stage(40, (1.0, 1.0, 0.75, 0.5), True, 400)
STAGES = (Stage(150, (0.3, 0.25, 0.2, 0.15, 0.15, 0.15), False, 60),
          Stage(300, (0.15, 0.15, 0.1, 0.1, 0.075, 0.075), False, 20))


def find_basins(points: Array,
                field: Field,
                config: SearchConfig,
                T_bone_tracker: Array | None = None,
                cancelled: Callable[[], bool] | None = None,
                progress: Callable[[float], None] | None = None) -> Array:
    """
    Return the distinct poses that fit, best first.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame, on strokes
    field : of the bone
    config : SearchConfig
    T_bone_tracker : (4, 4) float, a first guess to look around; None: everywhere
    cancelled, progress : as in `register`

    Returns
    -------
    (m, 4, 4) float, T_bone_tracker each

    Raises
    ------
    Refusal
        If cancelled.

    """
    points = points[thinned(points, config.spacing)]
    points = points[spread_sample(points, STAGES[-1].points)]
    centre = points.mean(axis=0)
    points = points - centre
    stages = len(STAGES) + (0 if T_bone_tracker is not None else 1 + config.parts)
    with ThreadPoolExecutor(config.threads or os.cpu_count() or 1) as pool:
        sieve = _Sieve(pool, field, config, cancelled, progress, stages)
        if T_bone_tracker is None:
            R, t = _first_sieve(sieve, points, *everywhere(field, config))
        else:
            R, t = around(T_bone_tracker, centre)
        for stage in STAGES:
            R, t = sieve(stage, points, R, t)
    return np.array([rigid.from_rt(A, b - A @ centre) for A, b in zip(R, t)])


def _first_sieve(sieve: _Sieve, points: Array, R: Array, t: Array) -> tuple[Array, Array]:
    """
    Sieve the starts by all points and by each part of them alone.

    Strokes on something else must not carry the rest away.
    """
    found = []
    for part in [points, *parts(points, sieve.config.parts)]:
        middle = part.mean(axis=0)
        A, b = sieve(FIRST, part - middle, R, t)
        found.append((A, b - A @ middle))
    return np.concatenate([A for A, _ in found]), np.concatenate([b for _, b in found])


def parts(points: Array, count: int) -> list[Array]:
    """Return ``count`` overlapping parts of the points, each a ball that holds 2/5 of them."""
    return [
        points[np.argsort(((points - points[seed])**2).sum(axis=1),
                          kind='stable')[:max(2 * len(points) // 5, 20)]]
        for seed in spread_sample(points, count)
    ]


class _Sieve:
    """Refines candidates on all cores; each for itself, so threads cannot change the answer."""

    def __init__(self, pool: ThreadPoolExecutor, field: Field, config: SearchConfig,
                 cancelled: Callable[[], bool] | None, progress: Callable[[float], None] | None,
                 stages: int) -> None:
        self.pool, self.field, self.config = pool, field, config
        self.cancelled, self.progress, self.stages, self.done = cancelled, progress, stages, 0

    def __call__(self, stage: Stage, points: Array, R: Array, t: Array) -> tuple[Array, Array]:
        """Return the distinct best of the candidates R (m, 3, 3), t (m, 3) after it, best first."""
        R, t, cost = R.copy(), t.copy(), np.full(len(R), np.inf)
        points = points[spread_sample(points, stage.points)]
        scales = self.config.reach * np.array(stage.scales)
        work = [
            self.pool.submit(_refine, self.field.arrays, stage.coarse, points, R[k:k + CHUNK],
                             t[k:k + CHUNK], scales, cost[k:k + CHUNK])
            for k in range(0, len(R), CHUNK)
        ]
        for task in work:
            task.result()
            if self.cancelled is not None and self.cancelled():
                self.pool.shutdown(cancel_futures=True)
                raise Refusal(Reason.NOT_CONVERGED,
                              'the registration was cancelled; the points are kept')
        self.done += 1
        if self.progress is not None:
            self.progress(self.done / self.stages)
        best = np.argsort(cost, kind='stable')
        best = best[distinct(R[best], t[best], points, self.config.spacing, stage.survivors)]
        return R[best], t[best]


def everywhere(field: Field, config: SearchConfig) -> tuple[Array, Array]:
    """
    Return starts (m, 3, 3) and (m, 3).

    Every rotation at every place, the points' centroid put on the surface.
    """
    surface = field.surface_points.astype(np.float64)
    places = surface[spread_sample(surface, config.places)]
    rotations = super_fibonacci(config.rotations)
    return np.repeat(rotations, len(places), axis=0), np.tile(places, (len(rotations), 1))


def around(T_bone_tracker: Array, centre: Array) -> tuple[Array, Array]:
    """
    Return starts turned about the centroid by up to some 30 degrees from a first guess.

    The guess comes first.
    """
    axes = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)],
                    dtype=np.float64)
    axes = axes[np.abs(axes).sum(axis=1) > 0]
    turns = [np.zeros(3)] + [
        math.radians(angle) * a / np.linalg.norm(a) for angle in (10.0, 20.0, 30.0) for a in axes
    ]
    R = np.array([rigid.rotation_exp(turn) @ T_bone_tracker[:3, :3] for turn in turns])
    return R, np.tile(rigid.transform(T_bone_tracker, centre), (len(R), 1))


def super_fibonacci(count: int) -> Array:
    """Return ``count`` rotations (count, 3, 3) spread evenly over SO(3) (Alexa, CVPR 2022)."""
    phi, psi = math.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, q = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    quaternions = np.stack(
        [r * np.sin(alpha), r * np.cos(alpha), q * np.sin(beta), q * np.cos(beta)], axis=1)
    return np.array([rigid.rotation_from_quaternion(x) for x in quaternions])


def distinct(R: Array, t: Array, points: Array, separation: float, count: int) -> NDArray[np.int64]:
    """Return the first ``count`` poses that move points ``separation`` (RMS) or more apart."""
    # the RMS distance of two poses over the points is a norm of [R, t]: embed them, then compare
    _, spread, axes = np.linalg.svd(points, full_matrices=False)
    embedded = np.concatenate(
        [(R @ (axes.T * spread / math.sqrt(len(points)))).reshape(len(R), -1), t], axis=1)
    return _distinct(embedded, separation**2, count)


@kernel
def _distinct(x, separation2, count):
    """Return the first ``count`` rows of ``x``, no two of them nearer than sqrt(separation2)."""
    chosen = np.zeros(min(count, len(x)), np.int64)
    m = 0
    for i in range(len(x)):
        new = True
        for j in range(m):
            squared = 0.0
            for a in range(x.shape[1]):
                squared += (x[i, a] - x[chosen[j], a]) ** 2
            if squared < separation2:
                new = False
                break
        if new:
            chosen[m] = i
            m += 1
            if m == len(chosen):
                break
    return chosen[:m]


@kernel
def _refine(field, coarse, points, R, t, scales, cost):
    """
    Pull in each candidate by a Gauss-Newton step a scale; then ``cost``: mean e^2 / (e^2 + c^2).

    That cost (Geman and McClure) levels off at one: a far point counts once, not by its distance.
    """
    A = np.zeros((6, 6))
    b = np.zeros(6)
    dx = np.zeros(6)
    for q in range(len(R)):
        for s in range(len(scales)):
            _normal_equations(field, coarse, points, R[q], t[q], scales[s] ** 2, A, b)
            for i in range(6):
                A[i, i] *= 1.001    # so that a patch of a sphere slides no farther than it must
            if not solve_cholesky(A, b, dx):
                break
            turn = math.sqrt(dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2])
            if turn > 0.5:
                dx *= 0.5 / turn
            update(R[q], t[q], dx)
        cost[q] = _cost(field, coarse, points, R[q], t[q], scales[-1] ** 2)


@nb.njit(nogil=True, cache=True, forceinline=True)
def _at(field, coarse, x, y, z):
    if coarse:
        return sample_coarse(field, x, y, z)
    d, gx, gy, gz = sample(field, x, y, z)
    return d, np.float32(gx), np.float32(gy), np.float32(gz)


@kernel
def _normal_equations(field, coarse, points, R, t, c2, A, b):
    """Fill A (lower triangle) and b (equations 5, 6), Geman-McClure weights of scale^2 ``c2``."""
    A[:] = 0.0
    b[:] = 0.0
    J = np.zeros(6)
    for k in range(len(points)):
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        x = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz
        y = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz
        z = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz
        d, gx, gy, gz = _at(field, coarse, x + t[0], y + t[1], z + t[2])
        w = (c2 / (c2 + d * d)) ** 2
        J[0], J[1], J[2] = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
        J[3], J[4], J[5] = gx, gy, gz
        for i in range(6):
            wj = w * J[i]
            b[i] -= wj * d
            for j in range(i + 1):
                A[i, j] += wj * J[j]


@kernel
def _cost(field, coarse, points, R, t, c2):
    """Return the mean Geman-McClure cost of the points."""
    total = 0.0
    for k in range(len(points)):
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        d, _, _, _ = _at(field, coarse, R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + t[0],
                         R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + t[1],
                         R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + t[2])
        total += d * d / (d * d + c2)
    return total / len(points)
