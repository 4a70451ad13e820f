# SPDX-License-Identifier: Apache-2.0
"""The whole pipeline on one screen."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, LimitsConfig
from gsdf_registration.common.formatting import format_length
from gsdf_registration.common.point_filters import filter_isolated
from gsdf_registration.common.result import (
    InputError,
    Reason,
    Refusal,
    RegistrationResult,
    as_numbers,
)
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.acceptance import (
    Candidate,
    describe,
    rejection_reasons,
    summary,
)
from gsdf_registration.registration.confidence import assess_at
from gsdf_registration.registration.landmarks import pose_from_landmarks
from gsdf_registration.registration.pose_selection import choose, solve_all
from gsdf_registration.search.global_search import find_start_poses


def register(points: ArrayLike,
             field: Field,
             config: Config = Config(),
             *,
             landmarks: tuple[ArrayLike, ArrayLike] | None = None,
             T_tracker_bone: ArrayLike | None = None,
             cancelled: Callable[[], bool] | None = None,
             progress: Callable[[float], None] | None = None,
             history: bool = False) -> RegistrationResult:
    """
    Find the bone under the points.

    Parameters
    ----------
    points : (n, 3) float, metres, tracker frame
        Where the probe tip has been, in any order.
    field : Field
        Of the bone.
    config : Config
    landmarks : (model (k, 3) in the bone frame, touched (k, 3) in the tracker frame), metres,
        optional
        For a first guess.
    T_tracker_bone : (4, 4) float, metres, optional
        The first guess itself.
    cancelled : called now and then; a true answer ends the work
    progress : called with the share of the search done, 0 to 1
    history : whether the result holds every step

    Returns
    -------
    RegistrationResult
        With a pose, or refused with a reason; bad data are a refusal too, never an exception.

    """
    started = perf_counter()
    received = 0
    try:
        # Refuse what no solver could answer
        points = as_numbers(points, 'points')
        received = len(points) if points.ndim else 0
        check_points(points, field, config.limits)
        guess = first_guess(landmarks, T_tracker_bone)
        # Points on strokes, each once; the rest is strewn interference or a reading repeated
        dense = filter_isolated(points)
        # Round the guess, if there is one; anywhere, if there is none or its result is doubtful
        for start in (None,) if guess is None else (guess, None):
            found = attempt(points, dense, start, field, config, cancelled, progress, history)
            refusal = next(rejection_reasons(found, points[dense], field, config), None)
            if refusal is None:
                break
    except Refusal as bad:
        return RegistrationResult.refused(bad.reason, bad.message, received=received)
    known = found.known
    known['received'] = received
    known['timing_s']['total'] = perf_counter() - started
    if refusal is None:
        return RegistrationResult(Reason.CONVERGED, summary(found), **known)
    return RegistrationResult.refused(
        refusal.reason, refusal.message,
        **{key: known[key]
           for key in known.keys() - {'T_tracker_bone', 'covariance'}})


def attempt(points: Array,
            dense: NDArray[np.bool_],
            guess: Array | None,
            field: Field,
            config: Config,
            cancelled: Callable[[], bool] | None = None,
            progress: Callable[[float], None] | None = None,
            history: bool = False) -> Candidate:
    """
    Return the best pose round ``guess``, T_bone_tracker, or anywhere; `rejection_reasons` judges it.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
    dense : (n,) bool, which of them to use

    Raises
    ------
    Cancelled

    """
    used = points[dense]
    started = perf_counter()
    # Where the bone may be
    basins = find_start_poses(used, field, config.search, guess, cancelled,
                         progress)
    searched = perf_counter()
    # The best of the local solutions, and the next-best elsewhere
    starts = [*basins] if guess is None else [guess, *basins]
    choice = choose(solve_all(used, field, starts, config, history, cancelled), used, field,
                    config.solver)
    # How good is it?
    confidence = assess_at(choice.solution, used, field, config.solver)
    found = describe(choice, confidence, dense, field, config)
    found.known['timing_s'] = {'search': searched - started, 'solve': perf_counter() - searched}
    return found


def check_points(points: Array, field: Field, limits: LimitsConfig) -> None:
    """
    Raise a Refusal that says what is wrong with the points (n, 3), m, if anything is.

    Their size is that between the 5th and 95th percentile, as interference may lie anywhere.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f'points must be an (n, 3) array, not of shape {points.shape}')
    # NaN, infinite, or a tracker's word for missing
    bad = int((~(np.abs(points) < rigid.MAX_COORDINATE).all(axis=1)).sum())
    if bad:
        raise InputError(
            f'not finite: {bad} of {len(points)} points; drop them before registering')
    if len(points) < limits.min_points:
        raise Refusal(
            Reason.TOO_FEW_POINTS,
            f'too few points: {len(points)}, and {limits.min_points} are needed; '
            'go on dragging the probe over the bone')
    extent = float(np.ptp(np.percentile(points, [5.0, 95.0], axis=0), axis=0).max())
    # a thousand times too large or too small, on a bone that may be exposed from end to end
    if not 0.002 * field.extent < extent < 20.0 * field.extent and extent > 0.0:
        raise Refusal(
            Reason.WRONG_UNIT,
            f'the points span {format_length(extent)} and the bone {format_length(field.extent)}: '
            'check the unit of the points (m or mm), and that the tip was moved')
    if extent < limits.min_extent:
        raise Refusal(
            Reason.REGION_TOO_SMALL,
            f'the points span only {format_length(extent)}, {format_length(limits.min_extent)} are '
            'needed; drag the probe over more of the bone')


def first_guess(landmarks: tuple[ArrayLike, ArrayLike] | None,
                T_tracker_bone: ArrayLike | None) -> Array | None:
    """Return the T_bone_tracker to look around, or None; raise InputError if it is no pose."""
    if T_tracker_bone is not None:
        T_tracker_bone = as_numbers(T_tracker_bone, 'the initial pose')
        if not rigid.is_rigid(T_tracker_bone):
            raise InputError(
                'the initial pose is not a 4x4 rigid motion (rotation, translation in metres)')
        return rigid.inverse(T_tracker_bone)
    return None if landmarks is None else rigid.inverse(pose_from_landmarks(*landmarks)[0])
