# SPDX-License-Identifier: Apache-2.0
"""Each acceptance criterion on both sides of its limit, and the order of the reasons."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, Refusal
from gsdf_registration.registration.acceptance import (
    CLEAR_INLIERS,
    MIN_FREE,
    acceptance_message,
    rejection_reasons,
)
from gsdf_registration.registration.candidate import Candidate
from gsdf_registration.registration.free_space import Blocked
from gsdf_registration.registration.pipeline import find_candidate
from gsdf_registration.registration.pose_selection import AlternativePose

POINTS = rigid.transform(T_TRACKER_BONE, touched_points(400, 0, 3e-4))
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)


@cache
def accepted() -> Candidate:
    """Return the candidate of 400 points on the bone."""
    return find_candidate(POINTS, bone_field(), Config(), [T_BONE_TRACKER])


def rejected_by(candidate: Candidate, **limits: Any) -> list[Refusal]:
    config = Config.from_flat({f'limits.{name}': value for name, value in limits.items()})
    return list(rejection_reasons(candidate, POINTS, bone_field(), config))


def reasons(candidate: Candidate, **limits: Any) -> list[Reason]:
    return [refusal.reason for refusal in rejected_by(candidate, **limits)]


def with_solution(candidate: Candidate, **changes: Any) -> Candidate:
    solution = replace(candidate.solution, **changes)
    return replace(candidate, selected=replace(candidate.selected, solution=solution))


def with_inliers(candidate: Candidate, count: int) -> Candidate:
    return with_solution(candidate, weights=(np.arange(len(POINTS)) < count).astype(float))


def with_confidence(candidate: Candidate, **changes: Any) -> Candidate:
    assert candidate.confidence is not None
    return replace(candidate, confidence=replace(candidate.confidence, **changes))


def with_alternative(candidate: Candidate, gap: float) -> Candidate:
    turned = rigid.exp([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]) @ T_BONE_TRACKER
    other = AlternativePose(turned, gap, 1.1)
    return replace(candidate, selected=replace(candidate.selected, alternatives=[other]))


def inlier_extent() -> float:
    return float(np.ptp(POINTS[accepted().inlier], axis=0).max())


def test_a_good_candidate_is_accepted() -> None:
    assert reasons(accepted()) == []


def test_the_share_of_inliers_is_limited() -> None:
    assert Reason.TOO_FEW_INLIERS in reasons(with_inliers(accepted(), 199), min_inliers=0.5)
    assert Reason.TOO_FEW_INLIERS not in reasons(with_inliers(accepted(), 200), min_inliers=0.5)


def test_the_number_of_inliers_is_limited() -> None:
    few, enough = (rejected_by(with_inliers(accepted(), count), min_points=30, min_inliers=0.0)
                   for count in (29, 30))
    assert few[0].reason is Reason.TOO_FEW_POINTS
    assert few[0].message.startswith('29 points on the bone, 30 are needed')
    assert Reason.TOO_FEW_POINTS not in [refusal.reason for refusal in enough]


def test_points_that_do_not_constrain_the_pose_have_no_further_reasons() -> None:
    unconstrained = with_solution(replace(accepted(), confidence=None, weakest_direction=None),
                                  converged=False)
    refusal, = rejected_by(unconstrained)
    assert refusal.reason is Reason.UNDER_CONSTRAINED
    assert refusal.message == ('the points do not constrain the pose; touch other sides of the '
                               'bone')
    assert refusal.advice == 'touch other sides of the bone'


def test_the_extent_of_the_inliers_is_limited() -> None:
    assert reasons(accepted(), min_extent=1.001 * inlier_extent()) == [Reason.REGION_TOO_SMALL]
    assert reasons(accepted(), min_extent=0.999 * inlier_extent()) == []


def test_the_noise_is_limited() -> None:
    assert reasons(with_confidence(accepted(), sigma=0.00201),
                   max_sigma=0.002) == [Reason.MODEL_MISMATCH]
    assert reasons(with_confidence(accepted(), sigma=0.002), max_sigma=0.002) == []


@pytest.mark.parametrize(('correlation', 'share', 'rejected'), [
    (1.56, CLEAR_INLIERS - 0.01, True), (1.55, CLEAR_INLIERS - 0.01, False),
    (1.56, CLEAR_INLIERS, False)], ids=['correlated', 'at the limit', 'clear inliers'])
def test_correlated_residuals_need_clear_inliers(correlation: float, share: float,
                                                 rejected: bool) -> None:
    candidate = with_inliers(with_confidence(accepted(), residual_correlation=correlation),
                             round(share * len(POINTS)))
    assert (Reason.MODEL_MISMATCH in reasons(candidate, max_pattern=1.55)) == rejected


def test_a_local_error_of_the_model_is_limited_by_the_expected_one() -> None:
    expected = Config().model.surface_error
    refusal, = rejected_by(with_confidence(accepted(), model_sd=2.01 * expected),
                           max_model_error=2.0)
    assert refusal.reason is Reason.MODEL_MISMATCH
    assert refusal.message.startswith('the bone deviates from its model by 0.5 mm (SD), '
                                      'model.surface_error is 0.25 mm; check that the model is ')
    assert reasons(with_confidence(accepted(), model_sd=2.0 * expected), max_model_error=2.0) == []


def test_correlated_residuals_are_allowed_if_an_error_of_the_model_explains_them() -> None:
    correlated = with_inliers(with_confidence(accepted(), residual_correlation=5.0), 360)
    assert reasons(correlated) == [Reason.MODEL_MISMATCH]
    assert reasons(with_confidence(correlated, model_sd=Config().model.surface_error)) == []


def test_an_alternative_pose_needs_a_gap() -> None:
    refusal, = rejected_by(with_alternative(accepted(), 23.9), min_gap=24.0)
    assert refusal.reason is Reason.AMBIGUOUS
    assert refusal.message.startswith('the points fit 2 poses about equally well; touch the bone ')
    assert len(refusal.next_touches) == 1 and refusal.next_touches[0].label == 'disambiguates'
    assert reasons(with_alternative(accepted(), 24.0), min_gap=24.0) == []


def test_the_solver_must_converge() -> None:
    stopped = with_solution(accepted(), converged=False, termination='40 iterations')
    refusal, = rejected_by(stopped)
    assert refusal.reason is Reason.NOT_CONVERGED
    assert refusal.message.startswith('the solver did not converge: 40 iterations; ')


@pytest.mark.parametrize(('require', 'where'), [
    ('touched', 'around the touched area'), ('bone', 'over the whole bone')])
def test_the_error_is_limited_where_it_is_required(require: str, where: str) -> None:
    candidate = accepted()
    assert candidate.weakest_direction is not None and candidate.zone is not None
    error = {'touched': candidate.zone.touched_p95_m, 'bone': candidate.zone.bone_p95_m}[require]
    refusal, = rejected_by(candidate, require=require, max_error=0.999 * error)
    assert refusal.reason is Reason.UNDER_CONSTRAINED
    assert f'the error {where} may be ' in refusal.message
    assert candidate.weakest_direction.sentence in refusal.message
    assert refusal.advice in refusal.message and len(refusal.next_touches) == 3
    assert reasons(candidate, require=require, max_error=1.001 * error) == []


def test_with_targets_only_their_error_is_limited() -> None:
    target = np.array([0.0, 0.0, 0.06])
    config = Config.from_flat({'targets.names': ['tip'], 'targets.positions': target.tolist()})
    candidate = find_candidate(POINTS, bone_field(), config, [T_BONE_TRACKER])
    assert candidate.zone is not None
    error = candidate.zone.p95_m['tip']

    def rejected(limit: float) -> list[Refusal]:
        limited = config.replaced({'limits.max_error': limit})
        return list(rejection_reasons(candidate, POINTS, bone_field(), limited))

    assert rejected(1.001 * error) == []
    assert 'at the targets' in rejected(0.999 * error)[0].message


def test_the_most_severe_reason_comes_first() -> None:
    bad = with_confidence(with_inliers(accepted(), 29), sigma=0.003, residual_correlation=9.0)
    bad = with_solution(with_alternative(bad, 0.0), converged=False)
    assert reasons(bad, min_extent=1.0, max_error=1e-5) == [
        Reason.TOO_FEW_INLIERS, Reason.TOO_FEW_POINTS, Reason.REGION_TOO_SMALL,
        Reason.MODEL_MISMATCH, Reason.MODEL_MISMATCH, Reason.AMBIGUOUS, Reason.NOT_CONVERGED,
        Reason.UNDER_CONSTRAINED]


def test_reasons_are_computed_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    def unexpected(*_: Any) -> None:
        raise AssertionError('computed the next touches for a reason that was not requested')
    monkeypatch.setattr('gsdf_registration.registration.acceptance.next_touches', unexpected)
    loose = Config.from_flat({'limits.max_error': 1e-5, 'limits.min_extent': 1.0})
    first = next(rejection_reasons(accepted(), POINTS, bone_field(), loose))
    assert first.reason is Reason.REGION_TOO_SMALL


def message(**changes: Any) -> str:
    return acceptance_message(with_confidence(accepted(), **changes))


def test_the_acceptance_message_names_points_error_and_weakest_direction() -> None:
    candidate = accepted()
    assert candidate.weakest_direction is not None
    error = f'{1e3 * candidate.predicted_tre_m["rms"]:.1f} mm'
    assert message(model_sd=0.0) == (
        f'pose found from {candidate.inliers} of 400 points; accurate to 2.0 mm (95 %) on the '
        f'whole bone; expected error {error} (RMS) over the bone; '
        f'{candidate.weakest_direction.sentence}')
    assert 'error of the model or the tracker of 0.25 mm (SD)' in message(model_sd=2.5e-4)


def test_an_expected_error_of_zero_is_never_reported() -> None:
    precise = replace(accepted(), predicted_tre_m={'rms': 1e-6, 'max': 2e-6})
    assert 'expected error < 0.1 mm (RMS)' in acceptance_message(precise)


def test_a_pose_with_the_probe_inside_the_bone_is_rejected() -> None:
    def blocked(log_likelihood: float, decided_by_air: bool = True) -> Candidate:
        air = Blocked(9, 120, 0.0123, log_likelihood)
        return replace(accepted(), selected=replace(accepted().selected, blocked=air,
                                                    decided_by_air=decided_by_air))
    assert reasons(blocked(MIN_FREE)) == []
    [refusal] = rejected_by(blocked(MIN_FREE - 0.1))
    assert refusal.reason is Reason.MODEL_MISMATCH
    inside = ('the probe has been where the bone would be, at 9 of 120 places and up to 12.3 mm '
              'deep; check')
    assert refusal.message.startswith(f'several poses fit the points, and {inside}')
    # the points alone leave no doubt
    clear = blocked(MIN_FREE - 0.1, False)
    assert reasons(clear) == [] and inside in acceptance_message(clear)
    assert inside not in acceptance_message(blocked(MIN_FREE))


def test_a_tip_that_may_be_off_by_more_than_the_limit_is_named() -> None:
    config = Config.from_flat({'probe.tip_error': 0.0013})
    candidate = find_candidate(POINTS, bone_field(), config, [T_BONE_TRACKER])
    refusal, = rejection_reasons(candidate, POINTS, bone_field(), config)
    assert refusal.reason is Reason.UNDER_CONSTRAINED
    assert refusal.message == (
        'the error of the tip may be 2.1 mm (95 %), 2 mm is allowed for the bone; calibrate the '
        'tip again, or correct probe.tip_error')
