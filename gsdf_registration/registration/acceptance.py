# SPDX-License-Identifier: Apache-2.0
"""The acceptance criteria: the reasons to reject a candidate, most severe first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, LimitsConfig
from gsdf_registration.common.formatting import format_count, format_error, format_length
from gsdf_registration.common.result import NextTouch, Reason, Refusal
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.candidate import Candidate
from gsdf_registration.registration.guidance import distinguishing_touch, next_touches
from gsdf_registration.registration.landmarks import named_points
from gsdf_registration.registration.wording import describe_place

NEARBY = 0.1    # m: the part of the bone around the touched area that a surgeon works on
# Share of the points: with so many inliers on the bone, correlated residuals come from an
# inaccurate model or tracker, for which the covariance allows, and not from another bone
CLEAR_INLIERS = 0.93
TOUCH_ELSEWHERE = 'touch other sides of the bone'


class ErrorLimit(NamedTuple):
    """
    A part of the bone where the predicted TRE is limited.

    where : str, as part of a sentence
    targets : (n, 3) float, m, bone frame
    limit : float, m (RMS)
    rows : (m,) bool, which surface points of the bone the targets are; None if they are others
    """

    where: str
    targets: Array
    limit: float
    rows: NDArray[np.bool_] | None


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
    yield from _check_fit(candidate, limits)
    touched = rigid.transform(candidate.solution.T_bone_tracker, on_bone)
    yield from _check_alternatives(candidate, touched, field, config)
    if not candidate.solution.converged:
        yield Refusal(Reason.NOT_CONVERGED,
                      f'the solver did not converge: {candidate.solution.termination}; touch more '
                      'of the bone or start from landmarks')
    yield from _check_predicted_tre(candidate, touched, field, config)


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


def _check_fit(candidate: Candidate, limits: LimitsConfig) -> Iterator[Refusal]:
    confidence, inliers, used = candidate.confidence, candidate.inliers, candidate.used
    assert confidence is not None
    if confidence.sigma > limits.max_sigma:
        yield Refusal(Reason.MODEL_MISMATCH,
                      f'the points scatter by {format_length(confidence.sigma)} about the surface '
                      'of the bone, more than any tracker does; check that this is the bone')
    if (confidence.residual_correlation > limits.max_pattern
            and inliers < CLEAR_INLIERS * used):
        yield Refusal(Reason.MODEL_MISMATCH,
                      f'{used - inliers} of {used} points lie off the bone, and the others fit it '
                      'no better than they would fit another bone; check that the model is of '
                      'this patient, this side and in this unit')


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


def _check_predicted_tre(candidate: Candidate, touched: Array, field: Field,
                         config: Config) -> Iterator[Refusal]:
    """Yield a refusal for the first part of the bone where the predicted TRE is over its limit."""
    assert candidate.confidence is not None and candidate.weakest_direction is not None
    for part in error_limits(touched, field, config):
        error = rigid.rms(candidate.confidence.predicted_tre(part.targets) if part.rows is None
                          else candidate.surface_tre[part.rows])
        if error > part.limit:
            touches = next_touches(candidate.confidence, field, touched, part.targets, config)
            advice = _advice(touches, touched, field, config)
            yield Refusal(
                Reason.UNDER_CONSTRAINED,
                f'the expected error {part.where} is {format_length(error)} (RMS), '
                f'{format_length(part.limit)} is allowed; '
                f'{candidate.weakest_direction.sentence}; {advice}', advice, touches)
            return


def error_limits(touched: Array, field: Field, config: Config) -> list[ErrorLimit]:
    """
    Return where the predicted TRE is limited.

    This is at the named targets; without any, on the bone within 100 mm of the ``touched`` points
    (n, 3), m, bone frame, and on the whole bone.
    """
    limits = config.limits
    if config.targets.names:
        return [ErrorLimit('at the targets', np.reshape(config.targets.positions, (-1, 3)),
                           limits.max_predicted_tre, None)]
    surface = field.surface_points.astype(np.float64)
    nearby = _is_nearby(surface, touched)
    return [ErrorLimit('around the touched area', surface[nearby], limits.max_predicted_tre,
                       nearby),
            ErrorLimit('over the whole bone (name targets if only a part of it matters)', surface,
                       limits.max_bone_tre, np.ones(len(surface), dtype=bool))]


def _is_nearby(surface: Array, touched: Array) -> NDArray[np.bool_]:
    """Return which points of ``surface`` (n, 3) are nearby any of ``touched`` (m, 3)."""
    # a few of the touched points decide for most, which takes a tenth of the time
    nearby = cdist(surface, touched[::-(-len(touched) // 16)]).min(axis=1) < NEARBY
    rest = cKDTree(touched).query(surface[~nearby], distance_upper_bound=NEARBY)[0] < NEARBY
    nearby[~nearby] = rest
    return nearby


def _advice(touches: Sequence[NextTouch], touched: Array, field: Field, config: Config) -> str:
    """Return a sentence on the first of the places to touch next."""
    if not touches:
        return TOUCH_ELSEWHERE
    place = describe_place(touches[0].position, touched, named_points(config), field)
    return f'touch the bone {place}'


def acceptance_message(candidate: Candidate) -> str:
    """Return one sentence on an accepted candidate."""
    assert candidate.confidence is not None and candidate.weakest_direction is not None
    error = format_error(candidate.predicted_tre_m['rms'])
    message = (f'pose found from {candidate.inliers} of {candidate.used} points; expected error '
               f'{error} (RMS) over the bone')
    if candidate.confidence.model_sd > 0.0:
        message += (', which includes a local error of the model or the tracker of '
                    f'{format_length(candidate.confidence.model_sd)} (SD)')
    return f'{message}; {candidate.weakest_direction.sentence}'
