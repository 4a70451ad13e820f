# SPDX-License-Identifier: Apache-2.0
"""What is known of a solution, whether it is good enough to be used, and both in plain words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration import rigid
from gsdf_registration.basins import Choice
from gsdf_registration.confidence import Confidence
from gsdf_registration.config import Config
from gsdf_registration.field import Field
from gsdf_registration.guidance import in_words, where_they_differ, where_to_touch
from gsdf_registration.result import Reason, Refusal
from gsdf_registration.rigid import Array

NEAR = 0.1  # m: the part of the bone that a wound's surgeon works on


def describe(choice: Choice, confidence: Confidence | None, dense: NDArray[np.bool_], field: Field,
             config: Config) -> dict[str, Any]:
    """
    Return what is known of a solution, as the fields of a `RegistrationResult`.

    Parameters
    ----------
    choice : of the local solutions
    confidence : of it; None if the points do not hold the pose
    dense : (n,) bool, which of the points given were used

    """
    solution = choice.solution
    T_tracker_bone = rigid.inverse(solution.T_bone_tracker)
    inlier = solution.weights > 0.5
    residuals, weights = np.full(len(dense), np.nan), np.zeros(len(dense))
    residuals[dense], weights[dense] = choice.residuals, solution.weights
    known: dict[str, Any] = {
        'T_tracker_bone': T_tracker_bone, 'covariance': None, 'used': int(dense.sum()),
        'inliers': int(inlier.sum()), 'runner_up_ratio': choice.runner_up_ratio,
        'iterations': solution.iterations, 'residual_rms_m': float(
            np.sqrt(np.mean(choice.residuals[inlier]**2))) if inlier.any() else None,
        'residuals_m': residuals, 'weights': weights, 'history': solution.history
    }
    if confidence is not None:
        named = named_points(config)
        surface = field.surface_points.astype(np.float64)
        everywhere = confidence.predicted_tre(surface)
        targets = confidence.predicted_tre(np.reshape(config.targets.positions, (-1, 3)))
        known |= {
            'sigma_m': confidence.sigma, 'covariance': confidence.pose_covariance(T_tracker_bone),
            'weakest_direction': confidence.weakest_direction(surface, named), 'predicted_tre_m': {
                **dict(zip(config.targets.names, targets.tolist())), 'rms': rms(everywhere),
                'max': float(everywhere.max())
            }
        }
    return known


def judge(known: dict[str, Any], choice: Choice, confidence: Confidence | None, points: Array,
          field: Field, config: Config) -> Refusal | None:
    """
    Return why a solution must not be used, or None if it may.

    ``points`` (n, 3) are those on strokes.
    """
    limits = config.limits
    inliers, used = known['inliers'], known['used']
    on_bone = points[choice.solution.weights > 0.5]
    if inliers < max(limits.min_inliers * used, limits.min_points):
        return Refusal(Reason.TOO_FEW_INLIERS, f'only {inliers} of {used} points lie on the bone; '
                       'check that this is the bone and the probe is the one calibrated')
    if confidence is None:
        return Refusal(Reason.UNDER_CONSTRAINED,
                       'the points do not hold the pose; touch other sides of the bone')
    extent = float(np.ptp(on_bone, axis=0).max())
    if extent < limits.min_extent:
        return Refusal(
            Reason.REGION_TOO_SMALL,
            f'the points on the bone span only {length(extent)}, {length(limits.min_extent)} are '
            'needed; drag the probe over more of the bone')
    if confidence.sigma > limits.max_sigma:
        return Refusal(
            Reason.MODEL_MISMATCH,
            f'the points scatter {length(confidence.sigma)} about the bone, more than any tracker '
            'does; check that this is the bone')
    if confidence.pattern > limits.max_pattern and inliers < limits.clear_inliers * used:
        return Refusal(
            Reason.MODEL_MISMATCH,
            f'{used - inliers} of {used} points lie off the bone, and the others fit it no better '
            'than another bone would; check that the model is of this patient, this side '
            'and this unit')
    touched = rigid.transform(choice.solution.T_bone_tracker, on_bone)
    for where, targets, limit in places_that_matter(touched, field, config):
        error = rms(confidence.predicted_tre(targets))
        if error > limit:
            best = where_to_touch(confidence, field, touched, targets, 1)[0]
            return Refusal(
                Reason.UNDER_CONSTRAINED,
                f'{length(error)} of error (RMS) must be expected {where}, {length(limit)} is '
                f'allowed; {known["weakest_direction"].sentence}; touch the bone '
                f'{in_words(best.position, touched, named_points(config))}')
    rivals = [rival.T_bone_tracker for rival in choice.rivals if rival.gap < limits.min_gap]
    if rivals:
        place = where_they_differ([choice.solution.T_bone_tracker, *rivals], field, touched)
        return Refusal(
            Reason.AMBIGUOUS,
            f'what was touched fits {1 + len(rivals)} poses about equally well; touch the bone '
            f'{in_words(place, touched, named_points(config))}, where they differ most')
    if not choice.solution.settled:
        return Refusal(
            Reason.NOT_CONVERGED, f'no pose was settled on: {choice.solution.termination}; '
            'touch more of the bone or start from landmarks')
    return None


def places_that_matter(touched: Array, field: Field,
                       config: Config) -> list[tuple[str, Array, float]]:
    """
    Return where the predicted TRE is limited: in words, points (n, 3), m, bone frame, and limit, m.

    At the named targets, or without any, on the bone within 100 mm of what was ``touched`` (n, 3),
    m, bone frame, and on the whole bone.
    """
    limits = config.limits
    if config.targets.names:
        return [('at the targets', np.reshape(config.targets.positions, (-1, 3)),
                 limits.max_predicted_tre)]
    surface = field.surface_points.astype(np.float64)
    near = cKDTree(touched).query(surface, distance_upper_bound=NEAR)[0] < NEAR
    return [('where the bone was touched', surface[near], limits.max_predicted_tre),
            ('over the bone (name targets if only a part matters)', surface,
             limits.max_bone_tre)]


def named_points(config: Config) -> dict[str, Array]:
    """Return the named landmarks and targets, (3,), m, bone frame, to speak of the bone by."""
    positions = np.reshape(config.landmarks.positions + config.targets.positions, (-1, 3))
    return dict(zip(config.landmarks.names + config.targets.names, positions))


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def summary(known: dict[str, Any]) -> str:
    """Return one plain sentence on a pose that may be used."""
    return (
        f'registered on {known["inliers"]} of {known["used"]} points; expected error '
        f'{1e3 * known["predicted_tre_m"]["rms"]:.1f} mm (RMS) over the bone; '
        f'{known["weakest_direction"].sentence}')


def length(metres: float) -> str:
    """Return a length in the unit that suits it."""
    return f'{metres:.3g} m' if metres >= 1.0 else f'{1e3 * metres:.3g} mm'
