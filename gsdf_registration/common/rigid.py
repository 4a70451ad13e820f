# SPDX-License-Identifier: Apache-2.0
"""
Rigid motions as 4x4 matrices.

``T_a_b`` maps coordinates in frame b to coordinates in frame a, ``x_a = T_a_b @ x_b``, so that
``T_a_c = T_a_b @ T_b_c``. A twist is ``[rx, ry, rz, tx, ty, tz]``: radians, then the unit of
length in use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# m; trackers mark a missing value with NaN or with a huge number (NDI: -3.7e28)
MAX_COORDINATE = 1e6


def skew(v: ArrayLike) -> Array:
    """
    Return the matrix of the cross product, ``skew(v) @ x == cross(v, x)``.

    Parameters
    ----------
    v : (3,) float

    Returns
    -------
    (3, 3) float

    """
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_exp(w: ArrayLike) -> Array:
    """
    Return the rotation about axis ``w`` by ``|w|`` radians (Rodrigues' formula).

    Parameters
    ----------
    w : (3,) float, radians

    Returns
    -------
    (3, 3) float, a proper rotation

    """
    w = np.asarray(w, dtype=np.float64)
    angle = float(np.linalg.norm(w))
    K = skew(w)
    # sinc keeps full precision at small angles: (1 - cos a)/a^2 = (sin(a/2)/(a/2))^2 / 2
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.eye(3) + a * K + b * (K @ K)


def rotation_log(R: ArrayLike) -> Array:
    """
    Return the rotation vector of ``R``; the inverse of `rotation_exp` for angles in [0, pi].

    Parameters
    ----------
    R : (3, 3) float, a proper rotation

    Returns
    -------
    (3,) float, radians

    """
    x, y, z, w = quaternion_from_rotation(R)
    v = np.array([x, y, z])
    n = float(np.linalg.norm(v))
    if n < 1e-12:
        return 2.0 * v
    return v * (2.0 * np.arctan2(n, w) / n)


def exp(twist: ArrayLike) -> Array:
    """
    Return the rigid motion of a screw, the exponential map of SE(3).

    Parameters
    ----------
    twist : (6,) float
        ``[rx, ry, rz, tx, ty, tz]``, radians and length.

    Returns
    -------
    (4, 4) float

    """
    twist = np.asarray(twist, dtype=np.float64)
    w, v = twist[:3], twist[3:]
    return from_rt(rotation_exp(w), _left_jacobian(w) @ v)


def log(T: ArrayLike) -> Array:
    """
    Return the twist of a rigid motion; the inverse of `exp` for angles in [0, pi).

    Parameters
    ----------
    T : (4, 4) float

    Returns
    -------
    (6,) float, ``[rx, ry, rz, tx, ty, tz]``

    """
    T = np.asarray(T, dtype=np.float64)
    w = rotation_log(T[:3, :3])
    return np.concatenate([w, np.linalg.solve(_left_jacobian(w), T[:3, 3])])


def _left_jacobian(w: Array) -> Array:
    """Return V of SE(3), ``exp([w, v]) = (exp(w), V v)``."""
    angle = float(np.linalg.norm(w))
    K = skew(w)
    b = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    # (a - sin a)/a^3 cancels below about 1e-2 rad: use its series there
    c = (1.0 / 6.0 - angle**2 / 120.0 if angle < 1e-2
         else (angle - np.sin(angle)) / angle**3)
    return np.eye(3) + b * K + c * (K @ K)


def from_rt(R: ArrayLike, t: ArrayLike) -> Array:
    """Return the 4x4 matrix of rotation ``R`` (3, 3) and translation ``t`` (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: ArrayLike) -> Array:
    """Return ``T_b_a`` of ``T_a_b`` (4, 4), exactly rigid."""
    T = np.asarray(T, dtype=np.float64)
    return from_rt(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def transform(T: ArrayLike, points: ArrayLike) -> Array:
    """
    Map points through a rigid motion.

    Parameters
    ----------
    T : (4, 4) float, ``T_a_b``
    points : (n, 3) or (3,) float, in b

    Returns
    -------
    same shape, in a

    """
    T = np.asarray(T, dtype=np.float64)
    return np.asarray(points, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]


def displacement(T_a: ArrayLike, T_b: ArrayLike, points: ArrayLike) -> Array:
    """Return the distance (n,) between the images of ``points`` (n, 3) under two motions."""
    return np.asarray(np.linalg.norm(transform(T_a, points) - transform(T_b, points), axis=1))


def rms_displacement(T_a: ArrayLike, T_b: ArrayLike, points: ArrayLike) -> float:
    """Return the RMS of `displacement` over ``points`` (n, 3)."""
    return rms(displacement(T_a, T_b, points))


def rms(values: Array) -> float:
    """Return the root mean square of ``values``."""
    return float(np.sqrt(np.mean(values**2)))


def rms_error(covariance: Array) -> float:
    """Return the expected length (RMS), m, of an error with this ``covariance`` (3, 3), m^2."""
    return float(np.sqrt(np.trace(covariance)))


def orthonormalized(T: ArrayLike) -> Array:
    """Return the rigid motion nearest to ``T`` (4, 4): its rotation projected by SVD."""
    T = np.asarray(T, dtype=np.float64)
    U, _, Vt = np.linalg.svd(T[:3, :3])
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return from_rt(U @ D @ Vt, T[:3, 3])


def is_rigid(T: ArrayLike, tolerance: float = 1e-6) -> bool:
    """Return whether ``T`` is a finite (4, 4) proper rigid motion within ``tolerance``."""
    T = np.asarray(T, dtype=np.float64)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= tolerance and np.linalg.det(R) > 0.0
                and np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() <= tolerance)


def fit_points(a: ArrayLike, b: ArrayLike) -> Array:
    """
    Return the rigid ``T_a_b`` that best maps points ``b`` onto ``a`` in the least-squares sense.

    Kabsch/Umeyama (Umeyama 1991, eq. 40-42) with unit scale and without reflections: a mirrored set
    yields the best proper rotation.

    Parameters
    ----------
    a, b : (n, 3) float, n >= 3, corresponding row by row

    Returns
    -------
    (4, 4) float

    Raises
    ------
    ValueError
        If the shapes differ or there are fewer than three pairs.

    """
    a = np.asarray(a, dtype=np.float64)
    b = np.asarray(b, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3 or len(a) < 3:
        raise ValueError(
            f'need two (n, 3) arrays of the same shape, n >= 3; got {a.shape} and {b.shape}')
    a0, b0 = a.mean(axis=0), b.mean(axis=0)
    U, _, Vt = np.linalg.svd((a - a0).T @ (b - b0))
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ D @ Vt
    return from_rt(R, a0 - R @ b0)


def quaternion_from_rotation(R: ArrayLike) -> Array:
    """
    Return the unit quaternion ``x, y, z, w`` with ``w >= 0`` (ROS order) of a rotation.

    Parameters
    ----------
    R : (3, 3) float, a proper rotation

    Returns
    -------
    (4,) float

    """
    R = np.asarray(R, dtype=np.float64)
    # Shepperd's method as a symmetric matrix with the rows 4 q_i q; the longest row is accurate
    d = np.diag(R)
    t = d.sum()
    s = R + R.T
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    Q = np.array([[1.0 - t + 2.0 * d[0], s[0, 1], s[0, 2], x],
                  [s[0, 1], 1.0 - t + 2.0 * d[1], s[1, 2], y],
                  [s[0, 2], s[1, 2], 1.0 - t + 2.0 * d[2], z],
                  [x, y, z, 1.0 + t]])
    q = Q[int(np.argmax(np.diag(Q)))]
    q = q / np.linalg.norm(q)
    return -q if q[3] < 0.0 else q


def rotation_from_quaternion(q: ArrayLike) -> Array:
    """
    Return the rotation of a quaternion ``x, y, z, w``, which is normalized first.

    Raises
    ------
    ValueError
        If it is not finite or of zero length.

    """
    q = np.asarray(q, dtype=np.float64)
    n = float(np.linalg.norm(q))
    if not np.isfinite(n) or n < 1e-9:
        raise ValueError(f'the quaternion {q.tolist()} is not finite or has zero length')
    x, y, z, w = q / n
    K = skew([x, y, z])
    return np.eye(3) + 2.0 * w * K + 2.0 * (K @ K)


def angle_between(R_a: ArrayLike, R_b: ArrayLike) -> float:
    """Return the angle in radians of the rotation from ``R_a`` to ``R_b`` (3, 3)."""
    return float(np.linalg.norm(rotation_log(np.asarray(R_a).T @ np.asarray(R_b))))
