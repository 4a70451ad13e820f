# SPDX-License-Identifier: Apache-2.0
"""The whole pipeline on one screen."""

from __future__ import annotations

from time import perf_counter
from typing import Callable

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration import rigid
from gsdf_registration.confidence import Confidence, assess
from gsdf_registration.config import Config, LimitsConfig
from gsdf_registration.field import Field
from gsdf_registration.landmarks import pose_from_landmarks
from gsdf_registration.result import InputError, Reason, Refusal, RegistrationResult
from gsdf_registration.rigid import Array
from gsdf_registration.solver import Solution, solve


def register(points: ArrayLike, field: Field, config: Config = Config(), *,
             stamps: ArrayLike | None = None, strokes: ArrayLike | None = None,
             landmarks: tuple[ArrayLike, ArrayLike] | None = None, T_tracker_bone: ArrayLike | None = None,
             cancelled: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None,
             history: bool = False) -> RegistrationResult:
    """
    Find the bone under the points.

    Parameters
    ----------
    points : (n, 3) float, metres, tracker frame
        Where the probe tip has been, in the order it went.
    field : Field
        Of the bone.
    config : Config
    stamps : (n,) float, seconds, optional
    strokes : (n,) int, optional
        Which stroke each point belongs to.
    landmarks : (model (k, 3) in the bone frame, touched (k, 3) in the tracker frame), metres, optional
        For a first guess.
    T_tracker_bone : (4, 4) float, metres, optional
        The first guess itself.
    cancelled : called now and then; a true answer ends the work
    progress : called with the share of the work done
    history : whether the result holds every step

    Returns
    -------
    RegistrationResult
        With a pose, or refused with a reason; bad data are a refusal too, never an exception.

    """
    started = perf_counter()
    received = len(points) if hasattr(points, '__len__') else 0
    try:
        # Refuse what no solver could answer
        used = check_points(points, field, config.limits)
        # First guess: a pose, else landmarks
        guess = first_guess(landmarks, T_tracker_bone)
        searched = perf_counter()
        # Local solution
        solution = solve(used, field, rigid.inverse(guess), config.solver, history)
        # How good is it, and is that good enough?
        centre = rigid.transform(solution.T_bone_tracker, used.mean(axis=0))
        confidence = assess(solution, centre)
        result = describe(solution, confidence, field, config, len(used))
        refusal = judge(result, solution, config.limits)
    except Refusal as bad:
        return RegistrationResult.refused(bad.reason, bad.message, received=received)
    ended = perf_counter()
    known = dict(result, received=received,
                 timing_s={'search': searched - started, 'solve': ended - searched, 'total': ended - started})
    if refusal is not None:
        known.pop('T_tracker_bone'), known.pop('covariance')
        return RegistrationResult.refused(refusal.reason, refusal.message, **known)
    return RegistrationResult(Reason.CONVERGED, summary(result), **known)


def check_points(points: ArrayLike, field: Field, limits: LimitsConfig) -> Array:
    """
    Return the points as (n, 3) float64, or raise a Refusal that says what is wrong with them.

    Their size is taken robustly, between the 5th and 95th percentile, for interference may lie anywhere.
    """
    try:
        points = np.ascontiguousarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f'points must be an (n, 3) array of numbers: {error}') from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f'points must be an (n, 3) array, not of shape {points.shape}')
    bad = int((~np.isfinite(points).all(axis=1)).sum())
    if bad:
        raise InputError(f'{bad} of {len(points)} points are not finite; drop them before registering')
    if len(points) < limits.min_points:
        raise Refusal(Reason.TOO_FEW_POINTS, f'{len(points)} points are too few, {limits.min_points} are needed; '
                      'go on dragging the probe over the bone')
    extent = float(np.ptp(np.percentile(points, [5.0, 95.0], axis=0), axis=0).max())
    if extent > 20.0 * field.extent or 0.0 < extent < 1e-3 * limits.min_extent * 5.0:
        raise Refusal(Reason.WRONG_UNIT, f'the points span {_length(extent)} and the bone {_length(field.extent)}: '
                      'their unit is not the one stated')
    if extent < limits.min_extent:
        raise Refusal(Reason.REGION_TOO_SMALL, f'the points span only {_length(extent)}, {_length(limits.min_extent)} are '
                      'needed; drag the probe over more of the bone')
    return points


def first_guess(landmarks: tuple[ArrayLike, ArrayLike] | None, T_tracker_bone: ArrayLike | None) -> Array:
    """Return the pose to start from, or raise a Refusal if there is none or it is no pose."""
    if T_tracker_bone is not None:
        if not rigid.is_rigid(T_tracker_bone):
            raise InputError('the initial pose is not a 4x4 rigid motion (rotation, translation in metres)')
        return np.asarray(T_tracker_bone, dtype=np.float64)
    if landmarks is not None:
        return pose_from_landmarks(*landmarks)[0]
    raise InputError('no first guess: touch three landmarks or give a pose')


def describe(solution: Solution, confidence: Confidence | None, field: Field, config: Config, used: int) -> dict[str, object]:
    """Return what is known of a solution, as the fields of a RegistrationResult."""
    T_tracker_bone = rigid.inverse(solution.T_bone_tracker)
    inlier = solution.weights > 0.5
    known: dict[str, object] = {
        'T_tracker_bone': T_tracker_bone, 'used': used, 'inliers': int(inlier.sum()), 'sigma_m': solution.sigma,
        'residual_rms_m': float(np.sqrt(np.mean(solution.residuals[inlier] ** 2))) if inlier.any() else None,
        'iterations': solution.iterations, 'residuals_m': solution.residuals, 'weights': solution.weights,
        'history': solution.history, 'covariance': None}
    if confidence is not None:
        names = dict(zip(config.landmarks.names + config.targets.names,
                         np.reshape(config.landmarks.positions + config.targets.positions, (-1, 3))))
        surface = field.surface_points.astype(np.float64)
        tre = confidence.predicted_tre(surface)
        at_targets = confidence.predicted_tre(np.reshape(config.targets.positions, (-1, 3)))
        known |= {'covariance': confidence.pose_covariance(T_tracker_bone),
                  'weakest_direction': confidence.weakest_direction(surface, names),
                  'predicted_tre_m': {**{name: float(v) for name, v in zip(config.targets.names, at_targets)},
                                      'rms': float(np.sqrt(np.mean(tre**2))), 'max': float(tre.max())}}
    return known


def judge(result: dict[str, object], solution: Solution, limits: LimitsConfig) -> Refusal | None:
    """Return why the solution must not be used, or None if it may."""
    inliers, used = result['inliers'], result['used']
    if not solution.settled:
        return Refusal(Reason.NOT_CONVERGED, f'no pose was settled on: {solution.termination}; give a better first guess or more points')
    if inliers < max(limits.min_inliers * used, 0.5 * limits.min_points):
        return Refusal(Reason.TOO_FEW_INLIERS, f'only {inliers} of {used} points lie on the bone; check that this is the bone and the probe')
    if solution.sigma > limits.max_sigma:
        return Refusal(Reason.MODEL_MISMATCH, f'the points lie {_length(solution.sigma)} off the bone, more than any noise; is it this bone?')
    if result['covariance'] is None:
        return Refusal(Reason.UNDER_CONSTRAINED, 'the points do not hold the pose; touch other sides of the bone')
    return None


def summary(result: dict[str, object]) -> str:
    """Return one plain sentence on a pose that may be used."""
    tre = result['predicted_tre_m']
    return (f'registered on {result["inliers"]} of {result["used"]} points; expected error {1e3 * tre["rms"]:.1f} mm (RMS) over the '
            f'bone; {result["weakest_direction"].sentence}')


def _length(metres: float) -> str:
    """Return a length in the unit that suits it."""
    return f'{metres:.3g} m' if metres >= 1.0 else f'{1e3 * metres:.3g} mm'
