# SPDX-License-Identifier: Apache-2.0
"""Poses of a moving body in the order of time, and the point of the body that moves least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gsdf_registration.common.rigid import MAX_COORDINATE, Array

NOT_RIGID = 1e-3        # tolerance of a rotation matrix


@dataclass(frozen=True)
class Poses:
    """Rotations (n, 3, 3) and positions (n, 3), m, in the order of time."""

    R: Array
    p: Array

    def __len__(self) -> int:
        return len(self.p)

    def __getitem__(self, rows: NDArray) -> Poses:
        return Poses(self.R[rows], self.p[rows])

    def places(self, point: Array) -> Array:
        """Return where ``point`` (3,), body frame, was at each pose (n, 3), tracker frame."""
        return np.asarray(np.einsum('nij,j->ni', self.R, point) + self.p)

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
class Clock:
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


def checked(T: ArrayLike, stamps: ArrayLike | None) -> tuple[Array, Array]:
    """Return poses (n, 4, 4) and times (n,): the stamps, or the numbers of the poses."""
    poses = np.asarray(T, dtype=np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise ValueError(f'poses must have the shape (n, 4, 4), not {poses.shape}')
    times = np.arange(len(poses), dtype=np.float64) if stamps is None else np.asarray(
        stamps, dtype=np.float64)
    if times.shape != (len(poses),):
        raise ValueError(f'{len(poses)} poses need {len(poses)} stamps, not {times.shape}')
    return poses, times


def rigid_rows(T: Array) -> NDArray[np.bool_]:
    """Return which of the poses (n, 4, 4) are rigid motions within the reach of a tracker."""
    with np.errstate(invalid='ignore', over='ignore'):
        R = T[:, :3, :3]
        skewed = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
        proper = np.linalg.det(R) > 0.0
        last = np.abs(T[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
        near = np.abs(T[:, :3, 3]).max(axis=1, initial=0.0) < MAX_COORDINATE
        return np.asarray((skewed <= NOT_RIGID) & proper & (last <= NOT_RIGID) & near)


def fresh_rows(T: Array) -> NDArray[np.bool_]:
    """Return which poses (n, 4, 4) are not the one before again: a repetition is no reading."""
    fresh = np.ones(len(T), dtype=bool)
    fresh[1:] = (T[1:] != T[:-1]).any(axis=(1, 2))
    return fresh


def nearest_rotations(R: Array) -> Array:
    """Return the rotations nearest to ``R`` (n, 3, 3), which are close to rotations."""
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt
