# SPDX-License-Identifier: Apache-2.0
"""
Score an answer: its errors, their ratio to the Cramer-Rao bound, and the verdict.

The bound is computed from the true positions and the true noise: no unbiased method has a smaller
error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from benchmarks.protocol.real_models import SMOOTH
from benchmarks.protocol.trials import Problem
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence, error_bound
from gsdf_registration.registration.zone import ErrorMap, map_error, required_part

MISPLACED = 0.005   # m, mean error where the bone was touched: the pose is in a wrong place
# the error of a place is understated if it exceeds FACTOR * the stated 95 % error + MARGIN
FACTOR, MARGIN = 2.0, 0.0005
REACHABLE = 1.5     # times the bound can be reached under interference
LENGTH = 0.008      # m, over which the error of a segmented or decimated model is correlated


@dataclass(frozen=True)
class PoseErrors:
    """
    Errors of a pose; metres, degrees.

    rotation_mae_deg : mean of |Euler angles| (x, y, z) of the rotation from the true to the found
    t_centroid_mae_m : mean of |x|, |y|, |z| of the error of the centroid of the points on the bone,
        bone axes
    t_origin_mae_m : the same for the translation of T_bone_tracker, that is at the origin of the
        tracker, up to 1.7 m away
    tre_mean_m, tre_rms_m, tre_p95_m, tre_max_m : displacement of the whole surface of the bone
    tre_region_m : mean displacement of the exposed area
    chamfer_m : one-way: mean distance of the measured points on the bone from its surface, which
        includes noise
    nees : e^T C^-1 e of the pose error e and the bound C; its expectation at the bound is 6
    """

    rotation_mae_deg: float
    t_centroid_mae_m: float
    t_origin_mae_m: float
    tre_mean_m: float
    tre_rms_m: float
    tre_p95_m: float
    tre_max_m: float
    tre_region_m: float
    chamfer_m: float
    nees: float

    @property
    def efficiency(self) -> float:
        """Return sqrt(NEES / 6): the error in units of the bound."""
        return float(np.sqrt(self.nees / 6.0))


def pose_errors(T_tracker_bone: Array, problem: Problem, bound: Confidence) -> PoseErrors:
    """
    Return the errors of a pose.

    Parameters
    ----------
    T_tracker_bone : (4, 4) float, m, the answer
    problem : its model is the bone that was touched
    bound : its `cramer_rao`

    """
    found, true = rigid.inverse(T_tracker_bone), rigid.inverse(problem.recording.T_tracker_bone)
    motion = found @ problem.recording.T_tracker_bone    # of the bone frame
    tre = rigid.displacement(motion, np.eye(4), problem.field.surface_points.astype(np.float64))
    region = rigid.displacement(motion, np.eye(4), problem.patch.corners.mean(axis=1))
    on_bone = rigid.transform(found, problem.recording.positions[problem.recording.on_bone])
    e = np.concatenate([rigid.rotation_log(motion[:3, :3]),
                        rigid.transform(motion, bound.centroid) - bound.centroid])
    return PoseErrors(
        rotation_mae_deg=float(np.abs(Rotation.from_matrix(motion[:3, :3]).as_euler(
            'xyz', degrees=True)).mean()),
        t_centroid_mae_m=float(np.abs(e[3:]).mean()),
        t_origin_mae_m=float(np.abs(found[:3, 3] - true[:3, 3]).mean()),
        tre_mean_m=float(tre.mean()), tre_rms_m=rigid.rms(tre),
        tre_p95_m=float(np.percentile(tre, 95.0)), tre_max_m=float(tre.max()),
        tre_region_m=float(np.average(region, weights=problem.patch.areas)),
        chamfer_m=float(np.abs(problem.field.sample(on_bone)[0]).mean()),
        nees=float(e @ np.linalg.solve(bound.motion_covariance, e)))


def cramer_rao(problem: Problem) -> Confidence:
    """
    Return the Cramer-Rao bound of the pose error for the data of a problem.

    C = (sum J J^T / (n^T S n))^-1 over the points on the bone, J = [(x - m) x n; n], S the noise's
    covariance in bone axes; about their centroid m.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points do not constrain the pose.

    """
    J, variance, confidence = _linearized(problem)
    C = np.asarray(np.linalg.inv((J.T / variance) @ J), np.float64)
    return replace(confidence, motion_covariance=C)


def attainable(problem: Problem) -> Confidence:
    """
    Return the bound of `cramer_rao` with the deviation of an inexact model as correlated noise.

    The deviation is a Gaussian process of known standard deviation and length, so no method can
    subtract it: generalized least squares with its covariance K attains
    C = (J^T (S + K)^-1 J)^-1. The error of the tip is added to that.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points do not constrain the pose.

    """
    J, variance, confidence = _linearized(problem)
    V = np.diag(variance) + _deviation(problem)
    C = np.asarray(np.linalg.inv(J.T @ np.linalg.solve(V, J)), np.float64)
    return replace(confidence, motion_covariance=C,
                   tip_error=problem.trial.scenario.settings['probe.tip_error'])


def evidence(problem: Problem) -> tuple[float, float] | None:
    """
    Return the log-likelihood ratio of a smooth deviation of the model over an exact model.

    First for the problem, then for an exact model with the same noise. Only the pose and the course
    of the deviation are unknown; the points on the bone, the noise, and standard deviation and
    length of the deviation are given. No test is more powerful than this ratio (Neyman and Pearson
    1933): what it misses, no method sees. Restricted likelihoods, as nothing is known of the pose.
    None: there is no such deviation.
    """
    if problem.trial.scenario.real_model not in SMOOTH:
        return None
    J, variance, _ = _linearized(problem)
    recording, noise = problem.recording, np.diag(variance)
    measured = rigid.transform(rigid.inverse(recording.T_tracker_bone),
                               recording.positions[recording.on_bone])
    e, deviation = problem.field.sample(measured)[0], problem.field.sample(problem.touched)[0]
    with_it, without = np.linalg.cholesky(noise + _deviation(problem)), np.linalg.cholesky(noise)

    def ratio(residuals: Array) -> float:
        return (_log_likelihood(residuals, J, np.asarray(with_it))
                - _log_likelihood(residuals, J, np.asarray(without)))
    return ratio(e), ratio(e - deviation)


def _log_likelihood(e: Array, J: Array, L: Array) -> float:
    """Return the restricted log-likelihood of residuals of covariance L L^T, less a constant."""
    scale = np.sqrt((J**2).sum(axis=0))     # the same for every L
    A, b = np.linalg.solve(L, J / scale), np.linalg.solve(L, e)
    rest = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    return float(-np.log(np.diag(L)).sum() - 0.5 * np.linalg.slogdet(A.T @ A)[1]
                 - 0.5 * rest @ rest)


def _deviation(problem: Problem) -> Array:
    """Return the covariance (n, n) of the deviation of the model at the points on the bone, m^2."""
    word, x = problem.trial.scenario.real_model, problem.touched
    sd = rigid.rms(problem.field.sample(x)[0]) if word else 0.0
    sd, length = SMOOTH.get(word, (sd, LENGTH))
    return np.asarray(sd**2 * np.exp(-0.5 * (cdist(x, x) / length)**2))


def _linearized(problem: Problem) -> tuple[Array, Array, Confidence]:
    """Return the derivatives by the pose (n, 6), the variances (n,), m^2, and a confidence."""
    x = problem.touched
    _, n = (problem.bone or problem.field).sample(x)
    m = x.mean(axis=0)
    J = np.concatenate([np.cross(x - m, n), n], axis=1)
    sigma = np.broadcast_to(problem.trial.scenario.sigma, 3)
    R_bone_tracker = problem.recording.T_tracker_bone[:3, :3].T
    variance = (n @ R_bone_tracker) ** 2 @ sigma**2
    return J, variance, Confidence(np.zeros((6, 6)), m, float(np.sqrt(np.mean(sigma**2))), 1.0)


def share_of_limits(problem: Problem, bound: Confidence, config: Config) -> float:
    """Return the 95 % error at the bound over its limit, where it is required; 1: just allowed."""
    errors = map_error(bound, problem.field.surface_points.astype(np.float64), problem.touched,
                       config)
    return required_part(errors, config).p95 / config.limits.max_error


def well_posed(problem: Problem, bound: Confidence | None, config: Config) -> bool:
    """
    Return whether a refusal of the problem would be a fault.

    That is so if the scenario is not a hard case and 1.5 times the error at the bound, `attainable`
    of the problem, is within `limits.max_error` in the part of the bone that `limits.require`
    names.
    """
    return (bound is not None and not problem.trial.scenario.hard
            and REACHABLE * share_of_limits(problem, bound, config) <= 1.0)


def verdict(problem: Problem, result: RegistrationResult, config: Config) -> str:
    """
    Return the verdict on an answer: right, refused, wrong or understated.

    A pose is wrong if the points are of a wrong bone, of an object or noise, or if its mean error
    where the bone was touched exceeds 5 mm. Its error is understated if a place of the part that
    `limits.require` names is off by more than twice its stated 95 % error + 0.5 mm.

    Parameters
    ----------
    problem : if its scenario is not wrong, its model is the bone that was touched
    result : of its points with the settings ``config``

    """
    T_tracker_bone, covariance = result.T_tracker_bone, result.covariance
    if T_tracker_bone is None or covariance is None:
        return 'refused'
    motion = rigid.inverse(T_tracker_bone) @ problem.recording.T_tracker_bone
    if problem.trial.scenario.wrong or _moved(motion, problem.touched).mean() > MISPLACED:
        return 'wrong'
    surface = problem.field.surface_points.astype(np.float64)
    stated = error_bound(T_tracker_bone, covariance, surface)
    distance = cKDTree(problem.touched).query(surface)[0]
    required = required_part(ErrorMap(surface, stated, distance, {}), config).points
    allowed = FACTOR * error_bound(T_tracker_bone, covariance, required) + MARGIN
    return 'understated' if (_moved(motion, required) > allowed).any() else 'right'


def _moved(motion: Array, places: Array) -> Array:
    return rigid.displacement(motion, np.eye(4), places)
