# SPDX-License-Identifier: Apache-2.0
"""
How good a pose is: its covariance, the error to expect at a target, and the motion held least.

All of it follows from one 6 x 6 matrix, the covariance of a small motion [rotation about m,
translation] of the bone frame, m the centroid of the points: for a target q the motion is B_q [xi,
phi] with B_q = [-(q - m)^, I].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as item

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import SolverConfig
from gsdf_registration.common.result import WeakestDirection
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.solver import Solution, nearest_neighbours


@dataclass(frozen=True)
class Confidence:
    """
    What the points say about the pose.

    motion_covariance : (6, 6) float, of [rotation about ``centre`` (rad), translation (m)], bone
        axes
    centre : (3,) float, m, bone frame: the centroid of the points
    sigma : float, m, noise of a point along the surface normal
    pattern : float, how much more residuals of neighbours vary together than white noise would, at
        the pose that takes them for that; 1 for the right bone and tracker
    model_sd : float, m, standard deviation of the model's own error; 0 where none is seen
    added : (6, 6) float, what that adds to the covariance
    """

    motion_covariance: Array
    centre: Array
    sigma: float
    pattern: float
    model_sd: float = 0.0
    added: Array = item(default_factory=lambda: np.zeros((6, 6)))

    def predicted_tre(self, targets: Array) -> Array:
        """Return the predicted TRE (n,) (RMS, m) at each of ``targets`` (n, 3), m, bone frame."""
        C = self.motion_covariance
        return _expected(C[3:, 3:], C[3:, :3], C[:3, :3], targets - self.centre)

    def pose_covariance(self, T_tracker_bone: Array) -> Array:
        """
        Return the (6, 6) pose covariance in REP-103 order: x y z rx ry rz, fixed axes, m and rad.

        A motion D of the bone frame turns ``T_tracker_bone`` into T D^-1, so the origin moves by R
        (xi x m - phi) and the attitude by -R xi.
        """
        R = T_tracker_bone[:3, :3]
        G = np.zeros((6, 6))
        G[:3, :3], G[:3, 3:], G[3:, :3] = -R @ rigid.skew(self.centre), -R, -R
        C = G @ self.motion_covariance @ G.T
        return np.asarray(0.5 * (C + C.T))

    def weakest_direction(self, surface: Array, names: Mapping[str, Array]) -> WeakestDirection:
        """
        Return the motion that the data hold least, as a screw.

        Least held is what moves the bone's surface (n, 3) most at one standard deviation: the
        largest eigenvalue of C in the metric M = mean B_q^T B_q, which weighs radians against
        metres as the bone's own size does.  ``names`` are points of the bone, m, to speak of it by.
        """
        B = motion_at(surface - self.centre)
        B = B.reshape(-1, 6)
        L = np.linalg.cholesky(3.0 * B.T @ B / len(B))
        values, vectors = np.linalg.eigh(L.T @ self.motion_covariance @ L)
        motion = np.linalg.solve(L.T, vectors[:, -1]) * np.sqrt(values[-1])
        return _screw(motion, self.centre, surface, names)


def predicted_tre(T_tracker_bone: Array, covariance: Array, points: Array) -> Array:
    """
    Return the predicted TRE (n,) (RMS, m) at ``points`` (n, 3), m, bone frame, of a pose.

    ``covariance`` (6, 6) is that of `Confidence.pose_covariance`: of the bone's origin (t) and its
    attitude about fixed axes (r).
    """
    return _expected(covariance[:3, :3], covariance[:3, 3:], covariance[3:, 3:],
                     points @ T_tracker_bone[:3, :3].T)


def _expected(C_tt: Array, C_tr: Array, C_rr: Array, arms: Array) -> Array:
    """
    Return the expected length (n,) (RMS) of t + r x a, r and t small with these covariances.

    Its mean square is a quadratic in the ``arms`` a (n, 3), so that a whole surface takes no time.
    """
    t_cross_r = np.array([C_tr[1, 2] - C_tr[2, 1], C_tr[2, 0] - C_tr[0, 2],
                          C_tr[0, 1] - C_tr[1, 0]])
    spread = np.trace(C_rr) * np.eye(3) - C_rr
    squared = ((arms @ spread + 2.0 * t_cross_r) * arms).sum(axis=1)
    return np.asarray(np.sqrt(np.trace(C_tt) + squared))


def motion_at(arms: Array) -> Array:
    """Return B = [-(q - m)^, I], (n, 3, 6), for ``arms`` q - m (n, 3)."""
    B = np.zeros((len(arms), 3, 6))
    x, y, z = arms.T
    B[:, 0, 1], B[:, 0, 2] = z, -y
    B[:, 1, 0], B[:, 1, 2] = -z, x
    B[:, 2, 0], B[:, 2, 1] = y, -x
    B[:, :, 3:] = np.eye(3)
    return B


def assess(solution: Solution, points: Array, neighbours: NDArray[np.int64]) -> Confidence | None:
    """
    Return the confidence of a solution, or None if its points do not hold the pose.

    The covariance of an M-estimate (Huber 1981, section 6.3), H^-1 S H^-1 with H = sum psi' J J^T,
    psi = w e, and S = sigma^2 sum w^2 J J^T the covariance of sum psi J; for plain least squares
    the Cramer-Rao bound sigma^2 (J^T J)^-1.  Each row of J and its residual are divided by the
    relative noise along its normal.  An error of the model that was allowed for takes from H and J
    what it may explain, and adds to S.

    Parameters
    ----------
    solution : of a solver
    points : (n, 3) float, metres, tracker frame, its points
    neighbours : (n, k) int, the points nearest to each, over which residuals are averaged

    """
    alone, error = _from_noise(solution), solution.model_error
    if alone is None:
        return None
    if error is None:
        pattern = _together(solution.weights, solution.residuals, neighbours)
        return _confidence(solution, points, alone, pattern, 0.0, np.zeros((6, 6)))
    both = _covariance(solution, error.jacobian, error.noise**2, error.lost, error.spread)
    if both is None:
        return None
    pattern = _together(solution.weights, error.residuals, neighbours)
    return _confidence(solution, points, alone, pattern, error.sd, both - alone)


def assess_at(solution: Solution, points: Array, field: Field,
              config: SolverConfig) -> Confidence | None:
    """Return `assess` over the points nearest to each along the bone."""
    around = nearest_neighbours(points, field, solution.T_bone_tracker)
    return assess(solution, points, around)


def reassess(before: Confidence, solution: Solution, points: Array) -> Confidence | None:
    """
    Return the confidence of a solution with a few more points than one ``before``.

    How much residuals vary together, and what an error of the model adds, is taken from there: that
    takes the most time and hardly changes.
    """
    alone = _from_noise(solution)
    if alone is None:
        return None
    return _confidence(solution, points, alone, before.pattern, before.model_sd, before.added)


def _confidence(solution: Solution, points: Array, alone: Array, pattern: float, model_sd: float,
                added: Array) -> Confidence:
    """Return the confidence with the covariance of noise ``alone``, and what is ``added`` to it."""
    w, e = solution.weights, np.nan_to_num(solution.residuals)
    centre = rigid.transform(solution.T_bone_tracker, points.mean(axis=0))
    sigma = float(np.sqrt((w * e**2).sum() / w.sum()))
    return Confidence(alone + added, centre, sigma, pattern, model_sd, added)


def _from_noise(solution: Solution) -> Array | None:
    """Return the covariance of `assess` as if the model had no error."""
    w, e, p = solution.weights, np.nan_to_num(solution.residuals), solution.precision
    variance = solution.model_error.noise**2 if solution.model_error is not None else float(
        ((w * p * e) ** 2).sum() / max((w**2).sum(), 1e-300))
    return _covariance(solution, solution.jacobian, variance)


def _covariance(solution: Solution, jacobian: Array, variance: float, lost: Array | float = 0.0,
                spread: Array | float = 0.0) -> Array | None:
    """
    Return the covariance of `assess`, or None if the points do not hold the pose.

    Parameters
    ----------
    solution : of a solver
    jacobian : (n, 6) float, J, less what an error of the model may explain
    variance : float, m^2, of a point's noise
    lost, spread : (6, 6) float, what such an error takes from H and adds to S / sigma^2

    """
    used = solution.weights > 0.0
    w, precision = solution.weights[used], solution.precision[used, None]
    if w.sum() < 6.0:
        return None
    J = precision * solution.jacobian[used]
    certain = (J.T * w) @ J - lost
    J = precision * jacobian[used]
    # where a few points of doubt hold the pose, what they take away may be more than there is;
    # then they count for nothing
    for curvature in (solution.curvature[used], np.clip(solution.curvature[used], 0.0, None)):
        H = certain - (J.T * (w - curvature)) @ J
        if _holds(H):
            break
    else:
        return None
    scale = np.sqrt(np.diag(H))
    H_inverse = np.linalg.inv(H / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(variance * H_inverse @ ((J.T * w**2) @ J + spread) @ H_inverse)


def _holds(H: Array) -> bool:
    """Tell whether an information matrix (6, 6) holds all six motions, whatever their units."""
    if not np.all(np.diag(H) > 0.0):
        return False
    scale = np.sqrt(np.diag(H))
    held = np.linalg.eigvalsh(H / np.outer(scale, scale))
    return bool(held[0] >= 1e-10 * held[-1])


def _together(w: Array, residuals: Array, neighbours: NDArray[np.int64]) -> float:
    """Return the mean of (sum w) m^2 / s^2, m the mean residual of neighbours; of noise it is 1."""
    e, around = np.nan_to_num(residuals), w[neighbours]
    count = np.maximum(around.sum(axis=1), 1e-9)
    mean = (around * e[neighbours]).sum(axis=1) / count
    return float((w * count * mean**2).sum() / max((w * e**2).sum(), 1e-300))


def _screw(motion: Array, centre: Array, surface: Array, names: Mapping[str,
                                                                        Array]) -> WeakestDirection:
    """Return the screw of a motion [xi, phi] about ``centre``, with its sentence."""
    xi, phi = motion[:3], motion[3:]
    angle = float(np.linalg.norm(xi))
    radius = float(np.sqrt(((surface - centre) ** 2).sum(axis=1).mean()))
    turns = angle * radius > 0.2 * np.linalg.norm(phi)
    direction = xi / angle if turns else phi / np.linalg.norm(phi)
    point = centre + np.cross(xi, phi) / angle**2 if turns else centre
    pitch = float(xi @ phi) / angle**2 if turns else float('inf')
    along = _direction_words(direction, surface)
    near = min(names, key=lambda name: float(np.linalg.norm(names[name] - point)), default=None)
    place = f'near {near}' if near else 'through ({:.0f}, {:.0f}, {:.0f}) mm'.format(*1e3 * point)
    if turns:
        sentence = (f'least held is a rotation about the axis {place} along {along}: '
                    f'{np.degrees(angle):.2f} deg (1 SD)')
    else:
        sentence = (f'least held is sliding along {along}: '
                    f'{1e3 * np.linalg.norm(phi):.2f} mm (1 SD)')
    return WeakestDirection(direction, point, pitch, angle, float(np.linalg.norm(phi)), sentence)


def _direction_words(direction: Array, surface: Array) -> str:
    """Name a direction: the bone's long axis if it is that, else components in the bone frame."""
    _, spread, axes = np.linalg.svd(surface - surface.mean(axis=0), full_matrices=False)
    if spread[0] > 2.0 * spread[1] and abs(axes[0] @ direction) > np.cos(np.radians(15.0)):
        return "the bone's long axis"
    return '({:.2f}, {:.2f}, {:.2f}) of the bone frame'.format(*direction)
