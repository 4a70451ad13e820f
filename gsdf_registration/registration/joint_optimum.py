# SPDX-License-Identifier: Apache-2.0
"""
The pose that fits the points and the landmarks together.

The objective is the sum of two: that of the points, of which only the information at their own
optimum and the residuals anywhere are used, and sum |r|^2 / (2 sigma^2) of the landmarks. A motion
of the bone frame is [xi, phi] as in `confidence`: a rotation xi about a centre and a translation
phi.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import motion_at
from gsdf_registration.registration.motions import inverse, moved

MAX_STEPS = 50
MAX_TURN = 0.1      # rad, of a step: beyond, the linearization says little
TOLERANCE = 1e-7    # m, of the last step, at the farthest landmark


def joint_optimum(T_bone_tracker: Array, points: Array, field: Field, weight: Array, factor: Array,
                  centre: Array, landmarks: Landmarks) -> tuple[Array, bool]:
    """
    Return the pose that fits points and landmarks together, and whether the steps converged.

    Gauss-Newton. At each pose the points are linearized again, J and e, with fixed weights W, and
    their score J^T W e is multiplied by a fixed matrix K, see `information_factor`. So the result
    is exact for independent points, also after a long motion that they constrain weakly, and to
    first order it is the minimum of the quadratic form of their information.

    Parameters
    ----------
    T_bone_tracker : (4, 4) float, metres
        The optimum of the points.
    points : (n, 3) float64, metres, tracker frame
    field : Field
    weight : (n,) float
    factor : (6, 6) float
        K; the inverse of the variance for independent points.
    centre : (3,) float, metres, bone frame
    landmarks : Landmarks
        With standard deviations.

    """
    used = weight > 0.0
    points, weight, T = points[used], weight[used], T_bone_tracker
    score, A = _points_at(T, points, field, weight, centre)
    at_start = score        # zero, up to other corrections
    for _ in range(MAX_STEPS):
        B, r, precision = linearize(T, centre, landmarks)
        step = -_solve(factor @ A + np.einsum('kij,kil,k->jl', B, B, precision),
                       factor @ (score - at_start) + np.einsum('kij,ki,k->j', B, r, precision))
        step *= min(1.0, MAX_TURN / max(float(np.linalg.norm(step[:3])), 1e-300))
        T = moved(step, centre) @ T
        if not len(B) or float(np.abs(B @ step).max()) < TOLERANCE:
            return T, True
        score, A = _points_at(T, points, field, weight, centre)
    return T, False


def information_factor(T_bone_tracker: Array, points: Array, field: Field, weight: Array,
                       information: Array, centre: Array) -> Array:
    """
    Return K = H (J^T W J)^-1 at a pose, for the ``information`` H (6, 6) of the points.

    H is less than that of independent points where residuals are correlated or points doubtful.
    """
    used = weight > 0.0
    A = _points_at(T_bone_tracker, points[used], field, weight[used], centre)[1]
    return np.asarray(information @ inverse(A))


def linearize(T_bone_tracker: Array, centre: Array,
              landmarks: Landmarks) -> tuple[Array, Array, Array]:
    """
    Return the landmarks at a pose.

    Returns
    -------
    B : (k, 3, 6) float, derivatives of the residuals by the motion
    r : (k, 3) float, m, residuals: where a landmark is less where it should be, bone frame
    precision : (k,) float, 1/m^2, 1 / sigma^2

    """
    at = rigid.transform(T_bone_tracker, landmarks.touched)
    return motion_at(at - centre), at - landmarks.model, 1.0 / landmarks.sigmas**2


def _points_at(T: Array, points: Array, field: Field, weight: Array,
               centre: Array) -> tuple[Array, Array]:
    """Return J^T W e (6,) and J^T W J (6, 6) of the points at a pose."""
    x = rigid.transform(T, points)
    e, normal = field.sample(x)
    J = np.concatenate([np.cross(x - centre, normal), normal], axis=1)
    weighted = J.T * weight
    return weighted @ e, weighted @ J


def _solve(H: Array, gradient: Array) -> Array:
    """Return H^-1 gradient, with unknowns of about equal scale."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(H)), 1e-300))
    return np.asarray(np.linalg.solve(H / np.outer(scale, scale), gradient / scale) / scale)
