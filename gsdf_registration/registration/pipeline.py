# SPDX-License-Identifier: Apache-2.0
"""The pipeline: search, solve, select a pose, assess it, accept or reject it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from dataclasses import replace
from itertools import islice
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.result import (
    ConsideredPoses,
    InputError,
    Reason,
    Refusal,
    RegistrationResult,
    as_numbers,
)
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.acceptance import rejection_reasons, verdict
from gsdf_registration.registration.candidate import Candidate, assess_candidate
from gsdf_registration.registration.confidence import Confidence, assess_at
from gsdf_registration.registration.evidence import Evidence
from gsdf_registration.registration.free_space import NO_PLACES, blocked, places, start_poses
from gsdf_registration.registration.input_checks import (
    check_points,
    check_selection,
    initial_guess,
)
from gsdf_registration.registration.landmark_evidence import for_tip, fuse, mistakes
from gsdf_registration.registration.local_solutions import solve_all
from gsdf_registration.registration.point_selection import (
    PointSelection,
    select_points,
    weights_of_all,
)
from gsdf_registration.registration.pose_selection import SelectedPose, select_pose
from gsdf_registration.search.global_search import MOST_POSES, START_POSES, find_start_poses
from gsdf_registration.solver import NO_TOUCHES

NEAR = 0.002        # m from the surface: points on the bone at a pose that is roughly right


def register(points: ArrayLike,
             field: Field,
             config: Config = Config(),
             *,
             landmarks: Landmarks | tuple[ArrayLike, ArrayLike] | None = None,
             air: ArrayLike | None = None,
             T_tracker_bone: ArrayLike | None = None,
             cancelled: Callable[[], bool] | None = None,
             progress: Callable[[float], None] | None = None,
             history: bool = False) -> RegistrationResult:
    """
    Find the pose of the bone from points on its surface.

    Parameters
    ----------
    points : (n, 3) float, metres, tracker frame
        Positions of the probe tip, the centre of its ball, in any order.
    field : Field
        Of the bone; with ``probe.tip_radius``, that for the ball tip is made from it.
    config : Config
    landmarks : Landmarks, or (model (k, 3) in the bone frame, touched (k, 3) in the tracker frame),
        metres, optional
        Three or more give an initial guess.
    air : (m, 3) float, metres, tracker frame, optional
        Where the tip or the shaft has been while not on the bone, which cannot be there: it helps
        to choose between poses that fit the points equally well.
    T_tracker_bone : (4, 4) float, metres, optional
        The initial guess itself.
    cancelled : callable, optional
        Called repeatedly; if it returns True, the registration stops.
    progress : callable, optional
        Called with the finished share of the search, 0 to 1.
    history : bool
        Whether the result contains every iteration.

    Returns
    -------
    RegistrationResult
        With a pose, or refused with a reason. Invalid inputs are refused and do not raise.

    """
    started = perf_counter()
    received, field = 0, field.for_tip(config.probe.tip_radius)
    try:
        points = as_numbers(points, 'points')
        received = len(points) if points.ndim else 0
        check_points(points, config.limits)
        evidence = _evidence(landmarks, air, field)
        guess = initial_guess(evidence.landmarks, T_tracker_bone)
        selection = select_points(points, config.collect.mode)
        check_selection(selection, points, field, config.limits)
        used, candidate, reasons = choose_candidate(
            find_candidates(selection, field, config, guess, evidence, cancelled=cancelled,
                            progress=progress, history=history),
            lambda used, found: tuple(islice(
                rejection_reasons(found, used.positions, field, config), 1)))
    except Refusal as error:
        return RegistrationResult.refused(error.reason, error.message, received=received)
    refusal = next(iter(reasons), None)
    reason, message = verdict(candidate, refusal, used.positions, field, config)
    message = '; '.join(filter(None, (message, mistakes(candidate.selected.landmarks))))
    result = replace(candidate.to_result(reason, message, used.rows, received),
                     considered=_considered(candidate, refusal, config))
    result = _with_points_left_out(result, candidate, points, used, field)
    return replace(result, timing_s={**result.timing_s, 'total': perf_counter() - started})


def _considered(candidate: Candidate, refusal: Refusal | None, config: Config) -> ConsideredPoses:
    """Return the poses behind the outcome, and where a touch would help."""
    T_tracker_bone = rigid.inverse(candidate.solution.T_bone_tracker)
    covariance = (None if candidate.confidence is None
                  else candidate.confidence.pose_covariance(T_tracker_bone))
    rivals = candidate.selected.ambiguous(config.limits.min_gap)
    return ConsideredPoses(T_tracker_bone, covariance, tuple(rigid.inverse(T) for T in rivals),
                           () if refusal is None else refusal.next_touches)


def _with_points_left_out(result: RegistrationResult, candidate: Candidate, points: Array,
                          selection: PointSelection, field: Field) -> RegistrationResult:
    """Return the result with the counts of points left out, and residuals for all but outliers."""
    left_out = selection.left_out
    result = replace(result, left_out=left_out)
    if not any(left_out[cause] for cause in ('downsampled', 'resting', 'moving')):
        return result
    T_bone_tracker = candidate.solution.T_bone_tracker
    residuals = field.sample(rigid.transform(T_bone_tracker, points))[0]
    weights = weights_of_all(points, selection.rows, candidate.solution.weights, residuals)
    assert result.residuals_m is not None
    known = np.isfinite(result.residuals_m)
    residuals[known] = result.residuals_m[known]
    message = result.message
    if left_out['resting'] and selection.rests:
        message += (f'; {left_out["resting"] + selection.rests} points at rest count as '
                    f'{format_count(selection.rests, "touch", "touches")}')
    if left_out['downsampled']:
        message += f'; {selection.total} points were downsampled to {len(selection.rows)}'
    return replace(result, message=message, residuals_m=residuals, weights=weights)


def _evidence(landmarks: Landmarks | tuple[ArrayLike, ArrayLike] | None,
              air: ArrayLike | None, field: Field) -> Evidence:
    """Return the evidence given to `register`; raise `InputError` if it is not valid."""
    if landmarks is None:
        landmarks = NO_LANDMARKS
    elif not isinstance(landmarks, Landmarks):
        try:
            model, touched = landmarks
        except (TypeError, ValueError):
            raise InputError('landmarks must be two arrays: the positions on the model and the '
                             'touched positions') from None
        landmarks = Landmarks.of(model, touched)
    return Evidence(for_tip(landmarks, field), NO_PLACES if air is None else places(air))


def _with_landmarks(selected: SelectedPose, confidence: Confidence | None, points: Array,
                    field: Field, evidence: Evidence) -> tuple[SelectedPose, Confidence | None]:
    """Return the pose of points and landmarks together, with its confidence."""
    landmarks = evidence.landmarks.measured
    if confidence is None or not len(landmarks):
        return selected, confidence
    solution, confidence, fits = fuse(selected.solution, confidence, points, field, landmarks)
    residuals = field.sample(rigid.transform(solution.T_bone_tracker, points))[0]
    return replace(selected, solution=solution, residuals=residuals, landmarks=fits), confidence


def find_candidates(selection: PointSelection,
                    field: Field,
                    config: Config,
                    guess: Array | None,
                    evidence: Evidence = Evidence(),
                    *,
                    cancelled: Callable[[], bool] | None = None,
                    progress: Callable[[float], None] | None = None,
                    history: bool = False) -> Iterator[tuple[PointSelection, Candidate]]:
    """
    Yield candidates and the points that they are computed from: those around a guess first.

    Each is computed only if the caller rejects the one before. Around the guess, T_bone_tracker, if
    there is one, and then everywhere, the `attempts` of the selection are tried one after another.
    If the other points fit the pose of rests alone, all are solved from there first. The other
    parameters are as in `find_candidate`.
    """
    def solve_from(attempt: PointSelection, starts: Sequence[Array]) -> Candidate:
        return find_candidate(attempt.positions, field, config, starts, evidence,
                              cancelled=cancelled, progress=progress, history=history,
                              touches=attempt.touches)

    for starts in ([],) if guess is None else ([guess], []):
        for attempt in selection.attempts(config.limits.min_points):
            candidate = solve_from(attempt, starts)
            others = selection.positions[:len(selection.rows) - len(attempt.rows)]
            if _fits(candidate, others, field, config):
                yield selection, solve_from(selection, [candidate.solution.T_bone_tracker])
            yield attempt, candidate


def choose_candidate(found: Iterable[tuple[PointSelection, Candidate]],
                     reject: Callable[[PointSelection, Candidate], tuple[Refusal, ...]],
                     tolerated: Set[Reason] = frozenset()
                     ) -> tuple[PointSelection, Candidate, tuple[Refusal, ...]]:
    """
    Return the first candidate that is accepted, else the last that does not only add interference.

    Parameters
    ----------
    found : of `find_candidates`, one or more
    reject : callable
        Returns the reasons to reject a candidate, most severe first.
    tolerated : set of Reason
        Reasons for which a candidate is accepted nevertheless.

    """
    answer: tuple[PointSelection, Candidate, tuple[Refusal, ...]] | None = None
    for used, candidate in found:
        reasons = reject(used, candidate)
        if answer is None or not _only_adds_interference(used, next(iter(reasons), None),
                                                         answer[0]):
            answer = used, candidate, reasons
        if {each.reason for each in reasons} <= tolerated:
            break
    assert answer is not None
    return answer


def _only_adds_interference(used: PointSelection, refusal: Refusal | None,
                           rests: PointSelection) -> bool:
    """Return whether a refusal is due to points beside the ``rests`` that were tried before."""
    return (refusal is not None and refusal.reason is Reason.TOO_FEW_INLIERS
            and len(used.rows) > len(rests.rows))


def _fits(candidate: Candidate, points: Array, field: Field, config: Config) -> bool:
    """Return whether other ``points`` (n, 3), m, also lie on the bone, in the only likely pose."""
    if not len(points) or candidate.selected.ambiguous(config.limits.min_gap):
        return False
    distance = field.sample(rigid.transform(candidate.solution.T_bone_tracker, points))[0]
    return bool((np.abs(distance) < NEAR).mean() >= config.limits.min_inliers)


def find_candidate(points: Array,
                   field: Field,
                   config: Config,
                   starts: Sequence[Array] = (),
                   evidence: Evidence = Evidence(),
                   *,
                   cancelled: Callable[[], bool] | None = None,
                   progress: Callable[[float], None] | None = None,
                   history: bool = False,
                   touches: Array = NO_TOUCHES) -> Candidate:
    """
    Run the pipeline once: search, solve, select, assess.

    Parameters
    ----------
    points : (n, 3) float64, metres, tracker frame
        Without isolated points.
    field : Field
    config : Config
    starts : sequence of (4, 4) float, T_bone_tracker, metres
        Poses to solve from in addition to those that the search finds. The search covers the
        surroundings of the first one, or the whole bone if there is none.
    evidence : Evidence
        What is known of the pose besides the points.
    cancelled, progress, history
        As in `register`.
    touches : (t,) float
        Relative noise of the last t points, which are touches.

    Raises
    ------
    Cancelled

    """
    started = perf_counter()
    found = find_start_poses(points, field, config.search, starts[0] if starts else None,
                             cancelled, progress, MOST_POSES)
    searched = perf_counter()

    def select(poses: Array, known: Evidence) -> SelectedPose:
        solutions = solve_all(points, field, [*starts, *poses], config, history, cancelled, touches,
                              known)
        return select_pose(solutions, points, field, config, known)
    air = evidence.air
    selected = select(found[:START_POSES], replace(evidence, air=NO_PLACES))
    if len(air) and selected.ambiguous(config.limits.min_gap):
        # only here, so that the air never costs a pose about which there is no doubt
        selected = select(start_poses(found, air, field, START_POSES), evidence)
        selected = replace(selected, decided_by_air=True)
    confidence = assess_at(selected.solution, points, field, config.probe.tip_error)
    selected, confidence = _with_landmarks(selected, confidence, points, field, evidence)
    selected = replace(selected, blocked=blocked(air, selected.solution.T_bone_tracker, field))
    timing_s = {'search': searched - started, 'solve': perf_counter() - searched}
    return assess_candidate(selected, confidence, points, field, config, timing_s)
