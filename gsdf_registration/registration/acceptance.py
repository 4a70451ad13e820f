# SPDX-License-Identifier: Apache-2.0
"""What is known of a solution, whether it is good enough to be used, and both in plain words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.formatting import counted, length
from gsdf_registration.common.result import ON_BONE, Reason, Refusal, Touch
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence
from gsdf_registration.registration.guidance import (
    advise,
    in_words,
    named_points,
    where_they_differ,
)
from gsdf_registration.registration.pose_selection import SelectedPose

NEAR = 0.1  # m: the part of the bone that a wound's surgeon works on


class Candidate(NamedTuple):
    """
    A solution with all that is known of it, whether or not it may be used.

    known : the fields of a `RegistrationResult`
    choice : of the local solutions
    confidence : in it; None if the points do not hold the pose
    surface_tre : (n,) float, m, predicted at the surface points of the bone; empty if that is None
    """

    known: dict[str, Any]
    choice: SelectedPose
    confidence: Confidence | None
    surface_tre: Array


class Place(NamedTuple):
    """
    Where the predicted TRE is limited.

    where : in words
    targets : (n, 3) float, m, bone frame
    limit : float, m (RMS)
    rows : which surface points of the bone these are; None if they are not
    """

    where: str
    targets: Array
    limit: float
    rows: NDArray[np.bool_] | None


def describe(choice: SelectedPose, confidence: Confidence | None, dense: NDArray[np.bool_], field: Field,
             config: Config) -> Candidate:
    """
    Return what is known of a solution.

    Parameters
    ----------
    choice : of the local solutions
    confidence : of it; None if the points do not hold the pose
    dense : (n,) bool, which of the points given were used

    """
    solution = choice.solution
    T_tracker_bone = rigid.inverse(solution.T_bone_tracker)
    inlier = solution.weights > ON_BONE
    residuals, weights = np.full(len(dense), np.nan), np.zeros(len(dense))
    residuals[dense], weights[dense] = choice.residuals, solution.weights
    known: dict[str, Any] = {
        'T_tracker_bone': T_tracker_bone, 'covariance': None, 'used': int(dense.sum()),
        'inliers': int(inlier.sum()), 'runner_up_ratio': choice.runner_up_ratio,
        'iterations': solution.iterations, 'residual_rms_m': float(
            np.sqrt(np.mean(choice.residuals[inlier]**2))) if inlier.any() else None,
        'residuals_m': residuals, 'weights': weights, 'history': solution.history
    }
    everywhere = np.zeros(0)
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
    return Candidate(known, choice, confidence, everywhere)


def rejection_reasons(found: Candidate, points: Array, field: Field, config: Config) -> Iterator[Refusal]:
    """
    Give the reasons why a solution must not be used, the gravest first; none if it may.

    Each is looked for when asked for.  ``points`` (n, 3) are those on strokes.
    """
    limits = config.limits
    known, choice, confidence, _ = found
    inliers, used = known['inliers'], known['used']
    on_bone = points[choice.solution.weights > ON_BONE]
    if inliers < limits.min_inliers * used:
        yield Refusal(Reason.TOO_FEW_INLIERS, f'the bone fits only {inliers} of {used} points; '
                      'check that this is the bone and the probe is the one calibrated')
    if inliers < limits.min_points:
        yield Refusal(
            Reason.TOO_FEW_POINTS,
            f'{counted(inliers, "point")} on the bone, {limits.min_points} are needed; '
            'go on dragging the probe over the bone')
    if confidence is None or not inliers:
        yield Refusal(Reason.UNDER_CONSTRAINED,
                      'the points do not hold the pose; touch other sides of the bone',
                      'touch other sides of the bone')
        return
    extent = float(np.ptp(on_bone, axis=0).max())
    if extent < limits.min_extent:
        yield Refusal(
            Reason.REGION_TOO_SMALL,
            f'the points on the bone span only {length(extent)}, {length(limits.min_extent)} are '
            'needed; drag the probe over more of the bone')
    if confidence.sigma > limits.max_sigma:
        yield Refusal(
            Reason.MODEL_MISMATCH,
            f'the points scatter {length(confidence.sigma)} about the bone, more than any tracker '
            'does; check that this is the bone')
    if confidence.pattern > limits.max_pattern and inliers < limits.clear_inliers * used:
        yield Refusal(
            Reason.MODEL_MISMATCH,
            f'{used - inliers} of {used} points lie off the bone, and the others fit it no better '
            'than another bone would; check that the model is of this patient, this side '
            'and this unit')
    touched = rigid.transform(choice.solution.T_bone_tracker, on_bone)
    rivals = choice.as_likely(limits.min_gap)
    if rivals:
        best = [where_they_differ([choice.solution.T_bone_tracker, *rivals], field, touched)]
        touch = f'{_in_words(best, touched, field, config)}, where they differ most'
        yield Refusal(
            Reason.AMBIGUOUS,
            f'what was touched fits {1 + len(rivals)} poses about equally well; {touch}', touch,
            best)
    if not choice.solution.settled:
        yield Refusal(
            Reason.NOT_CONVERGED, f'no pose was settled on: {choice.solution.termination}; '
            'touch more of the bone or start from landmarks')
    place, error = first_imprecise_place(found, touched, field, config)
    if place is not None:
        best = advise(confidence, field, touched, place.targets, config)
        touch = _in_words(best, touched, field, config)
        yield Refusal(
            Reason.UNDER_CONSTRAINED,
            f'{length(error)} of error (RMS) must be expected {place.where}, '
            f'{length(place.limit)} is allowed; {known["weakest_direction"].sentence}; {touch}',
            touch, best)


def _in_words(best: Sequence[Touch], touched: Array, field: Field, config: Config) -> str:
    """Say where a touch would help most: at the first of the ``best``."""
    if not best:
        return 'touch other sides of the bone'
    return f'touch the bone {in_words(best[0].position, touched, named_points(config), field)}'


def first_imprecise_place(found: Candidate, touched: Array, field: Field,
              config: Config) -> tuple[Place | None, float]:
    """Return the first place where more error is predicted than is allowed, if any, and that, m."""
    assert found.confidence is not None
    for place in places_that_matter(touched, field, config):
        error = rms(found.confidence.predicted_tre(place.targets) if place.rows is None else
                    found.surface_tre[place.rows])
        if error > place.limit:
            return place, error
    return None, 0.0


def places_that_matter(touched: Array, field: Field, config: Config) -> list[Place]:
    """
    Return where the predicted TRE is limited.

    At the named targets, or without any, on the bone within 100 mm of what was ``touched`` (n, 3),
    m, bone frame, and on the whole bone.
    """
    limits = config.limits
    if config.targets.names:
        return [Place('at the targets', np.reshape(config.targets.positions, (-1, 3)),
                      limits.max_predicted_tre, None)]
    surface = field.surface_points.astype(np.float64)
    near = _near(surface, touched)
    return [Place('where the bone was touched', surface[near], limits.max_predicted_tre, near),
            Place('over the bone (name targets if only a part matters)', surface,
                  limits.max_bone_tre, np.ones(len(surface), dtype=bool))]


def _near(surface: Array, touched: Array) -> NDArray[np.bool_]:
    """Tell which of ``surface`` (n, 3) lie near to any of ``touched`` (m, 3)."""
    # a few of them decide for most, which takes a tenth of the time
    near = cdist(surface, touched[::-(-len(touched) // 16)]).min(axis=1) < NEAR
    rest = cKDTree(touched).query(surface[~near], distance_upper_bound=NEAR)[0] < NEAR
    near[~near] = rest
    return near


def moved(T_before: Array, T_after: Array, field: Field) -> float:
    """Return how far the surface of the bone moved, m (RMS), from one T_tracker_bone to another."""
    return rms(rigid.displacement(T_before, T_after, field.surface_points.astype(np.float64)))


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def summary(found: Candidate) -> str:
    """Return one plain sentence on a pose that may be used."""
    known, confidence = found.known, found.confidence
    off = confidence.model_sd if confidence is not None else 0.0
    return (
        f'registered on {known["inliers"]} of {known["used"]} points; expected error '
        f'{1e3 * known["predicted_tre_m"]["rms"]:.1f} mm (RMS) over the bone'
        + (f', as the model or the tracker is off by {length(off)} (SD) from place to place'
           if off > 0.0 else '') + f'; {known["weakest_direction"].sentence}')
