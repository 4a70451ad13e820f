# SPDX-License-Identifier: Apache-2.0
"""The acceptance criteria: the reasons to reject a candidate, most severe first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, LimitsConfig
from gsdf_registration.common.formatting import format_count, format_error, format_length
from gsdf_registration.common.result import NextTouch, Reason, Refusal
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.candidate import Candidate
from gsdf_registration.registration.free_space import Blocked
from gsdf_registration.registration.guidance import distinguishing_touch, next_touches
from gsdf_registration.registration.landmarks import MIN_LANDMARKS, named_points
from gsdf_registration.registration.surface_offset import FITTING_CORRELATION, find_offset
from gsdf_registration.registration.wording import describe_place
from gsdf_registration.registration.zone import required_part

# Share of the points: if fewer are on the bone, correlated residuals without a local error that
# explains them may come from another bone, the rest of whose points is taken for interference
CLEAR_INLIERS = 0.93
# Log-likelihood of the places in the air below which they contradict a pose: eleven in the bone
MIN_FREE = -24.0
TOUCH_ELSEWHERE = 'touch other sides of the bone'


def rejection_reasons(candidate: Candidate, points: Array, field: Field,
                      config: Config) -> Iterator[Refusal]:
    """
    Yield the reasons to reject a candidate, most severe first; none if it is accepted.

    Each is computed when it is requested.

    Parameters
    ----------
    candidate : Candidate
    points : (n, 3) float, metres, tracker frame
        The points used.
    field : Field
    config : Config

    """
    limits = config.limits
    on_bone = points[candidate.inlier]
    yield from _check_inliers(candidate, limits)
    if candidate.confidence is None or not len(on_bone):
        yield Refusal(Reason.UNDER_CONSTRAINED,
                      f'the points do not constrain the pose; {TOUCH_ELSEWHERE}', TOUCH_ELSEWHERE)
        return
    yield from _check_extent(on_bone, limits)
    yield from _check_fit(candidate, config)
    yield from _check_landmarks(candidate)
    yield from _check_free_space(candidate)
    touched = rigid.transform(candidate.solution.T_bone_tracker, on_bone)
    yield from _check_alternatives(candidate, touched, field, config)
    if not candidate.solution.converged:
        yield Refusal(Reason.NOT_CONVERGED,
                      f'the solver did not converge: {candidate.solution.termination}; touch more '
                      'of the bone or start from landmarks')
    yield from _check_error(candidate, touched, field, config)


def verdict(candidate: Candidate, refusal: Refusal | None, points: Array, field: Field,
            config: Config) -> tuple[Reason, str]:
    """
    Return reason and message of the result.

    If the points fit the bone moved outward or inward, that is the reason of a refusal, and a
    remark on an accepted pose.

    Parameters
    ----------
    candidate : Candidate
    refusal : the first of `rejection_reasons`; None: there is none
    points, field, config : as in `rejection_reasons`

    """
    offset = (find_offset(candidate.solution, points, field, config)
              if _fits_badly(candidate) else None)
    if refusal is None:
        message = acceptance_message(candidate)
        return Reason.CONVERGED, message if offset is None else f'{message}; {offset.sentence}'
    if offset is None:
        return refusal.reason, refusal.message
    return Reason.MODEL_MISMATCH, offset.sentence


def _fits_badly(candidate: Candidate) -> bool:
    """Return whether an offset is worth a search: points lie off the bone, or residuals agree."""
    confidence = candidate.confidence
    return candidate.solution.estimates is not None and confidence is not None and (
        candidate.inliers < CLEAR_INLIERS * candidate.used or confidence.model_sd > 0.0
        or confidence.residual_correlation > FITTING_CORRELATION)


def _check_inliers(candidate: Candidate, limits: LimitsConfig) -> Iterator[Refusal]:
    inliers, used = candidate.inliers, candidate.used
    if inliers < limits.min_inliers * used:
        yield Refusal(Reason.TOO_FEW_INLIERS,
                      f'only {inliers} of {used} points lie on the bone; check that this is the '
                      'bone and that the probe is calibrated')
    if inliers < limits.min_points:
        yield Refusal(Reason.TOO_FEW_POINTS,
                      f'{format_count(inliers, "point")} on the bone, {limits.min_points} are '
                      'needed; drag the probe over more of the bone')


def _check_extent(on_bone: Array, limits: LimitsConfig) -> Iterator[Refusal]:
    extent = float(np.ptp(on_bone, axis=0).max())
    if extent < limits.min_extent:
        yield Refusal(Reason.REGION_TOO_SMALL,
                      f'the points on the bone span only {format_length(extent)}, '
                      f'{format_length(limits.min_extent)} are needed; drag the probe over more '
                      'of the bone')


def _check_fit(candidate: Candidate, config: Config) -> Iterator[Refusal]:
    confidence, inliers, used = candidate.confidence, candidate.inliers, candidate.used
    assert confidence is not None
    limits, expected = config.limits, config.model.surface_error
    if confidence.sigma > limits.max_sigma:
        yield Refusal(Reason.MODEL_MISMATCH,
                      f'the points scatter by {format_length(confidence.sigma)} about the surface '
                      'of the bone, more than any tracker does; check that this is the bone')
    if confidence.model_sd > limits.max_model_error * expected:
        yield Refusal(Reason.MODEL_MISMATCH,
                      f'the bone deviates from its model by {format_length(confidence.model_sd)} '
                      f'(SD), model.surface_error is {format_length(expected)}; check that the '
                      'model is of this patient, this side and in this unit, or set '
                      'model.surface_error if it is so inaccurate')
    elif (confidence.model_sd == 0.0 and confidence.residual_correlation > limits.max_pattern
            and inliers < CLEAR_INLIERS * used):
        yield Refusal(Reason.MODEL_MISMATCH,
                      f'{used - inliers} of {used} points lie off the bone, and the others fit it '
                      'no better than they would fit another bone; check that the model is of '
                      'this patient, this side and in this unit')


def _check_free_space(candidate: Candidate) -> Iterator[Refusal]:
    """Yield a refusal if the air had to decide and is against all poses."""
    selected = candidate.selected
    if selected.decided_by_air and selected.blocked.log_likelihood < MIN_FREE:
        yield Refusal(Reason.MODEL_MISMATCH,
                      f'several poses fit the points, and {_blocked_sentence(selected.blocked)}')


def _blocked_sentence(blocked: Blocked) -> str:
    """Return a sentence on the places in the air that are inside the bone."""
    return (f'the probe has been where the bone would be, at {blocked.places} of {blocked.total} '
            f'places and up to {format_length(blocked.depth)} deep; check that the model is of '
            'this patient and side, and the tip and the shaft of the probe, or set collect.air to '
            'false if bone has been removed')


def _check_landmarks(candidate: Candidate) -> Iterator[Refusal]:
    """Yield a refusal if most of three or more landmarks contradict the points."""
    fits = candidate.selected.landmarks
    wrong = sum(not fit.used for fit in fits)
    if len(fits) >= MIN_LANDMARKS and 2 * wrong > len(fits):
        yield Refusal(Reason.MODEL_MISMATCH,
                      f'{wrong} of {len(fits)} landmarks contradict the points; check in which '
                      'order they were touched, landmarks.sigmas, and that the model is of this '
                      'patient and this side')


def _check_alternatives(candidate: Candidate, touched: Array, field: Field,
                        config: Config) -> Iterator[Refusal]:
    """Yield a refusal if another pose fits the points about equally well."""
    alternatives = candidate.selected.ambiguous(config.limits.min_gap)
    if not alternatives:
        return
    poses = [candidate.solution.T_bone_tracker, *alternatives]
    touches = [distinguishing_touch(poses, field, touched)]
    advice = f'{_advice(touches, touched, field, config)}, where the poses differ most'
    yield Refusal(Reason.AMBIGUOUS,
                  f'the points fit {len(poses)} poses about equally well; {advice}', advice,
                  touches)


def _check_error(candidate: Candidate, touched: Array, field: Field,
                 config: Config) -> Iterator[Refusal]:
    """Yield a refusal if a part of the bone that is required is not in the zone."""
    assert candidate.confidence is not None and candidate.weakest_direction is not None
    assert candidate.errors is not None
    part, limit = required_part(candidate.errors, config), config.limits.max_error
    if part.p95 <= limit:
        return
    # by the error of the tip alone, which is the same at all places
    alone = replace(candidate.confidence, motion_covariance=np.zeros((6, 6)))
    tip = float(alone.p95(alone.centroid[None])[0])
    if tip > limit:
        yield Refusal(Reason.UNDER_CONSTRAINED,
                      f'the error of the tip may be {format_length(tip)} (95 %), '
                      f'{format_length(limit)} is allowed for the bone; calibrate the tip again, '
                      'or correct probe.tip_error')
        return
    touches = next_touches(candidate.confidence, field, touched, part.points, config)
    advice = _advice(touches, touched, field, config)
    yield Refusal(Reason.UNDER_CONSTRAINED,
                  f'the error {part.where} may be {format_length(part.p95)} (95 %), '
                  f'{format_length(limit)} is allowed; {candidate.weakest_direction.sentence}; '
                  f'{advice}', advice, touches)


def _advice(touches: Sequence[NextTouch], touched: Array, field: Field, config: Config) -> str:
    """Return a sentence on the first of the places to touch next."""
    if not touches:
        return TOUCH_ELSEWHERE
    place = describe_place(touches[0].position, touched, named_points(config), field)
    return f'touch the bone {place}'


def acceptance_message(candidate: Candidate) -> str:
    """Return one sentence on an accepted candidate."""
    assert candidate.confidence is not None and candidate.weakest_direction is not None
    assert candidate.zone is not None
    error = format_error(candidate.predicted_tre_m['rms'])
    message = (f'pose found from {candidate.inliers} of {candidate.used} points; '
               f'{candidate.zone.sentence}; expected error {error} (RMS) over the bone')
    if candidate.confidence.model_sd > 0.0:
        message += (', which includes a local error of the model or the tracker of '
                    f'{format_length(candidate.confidence.model_sd)} (SD)')
    message = f'{message}; {candidate.weakest_direction.sentence}'
    if candidate.selected.blocked.log_likelihood < MIN_FREE:
        message += f'; {_blocked_sentence(candidate.selected.blocked)}'
    return message
