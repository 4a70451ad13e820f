# SPDX-License-Identifier: Apache-2.0
"""The result of a candidate."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason
from gsdf_registration.registration.candidate import Candidate, assess_candidate
from gsdf_registration.registration.pipeline import find_candidate

POINTS = rigid.transform(T_TRACKER_BONE, touched_points(400, 0, 3e-4))
CONFIG = Config.from_flat({'targets.names': ['tip'], 'targets.positions': [0.0, 0.0, 0.06]})


@pytest.fixture(scope='module')
def candidate() -> Candidate:
    return find_candidate(POINTS, bone_field(), CONFIG, [rigid.inverse(T_TRACKER_BONE)])


@pytest.mark.parametrize('reason', [Reason.CONVERGED, Reason.AMBIGUOUS])
def test_only_an_accepted_candidate_yields_a_pose(candidate: Candidate, reason: Reason) -> None:
    result = candidate.to_result(reason, 'message', np.arange(400), 400)
    assert (result.T_tracker_bone is None) == (result.covariance is None) == (not result.success)
    assert (result.reason, result.message) == (reason, 'message')
    assert result.predicted_tre_m == candidate.predicted_tre_m
    assert result.weakest_direction is candidate.weakest_direction
    assert {'search', 'solve'} == set(result.timing_s)


def test_points_that_were_not_used_have_no_residual_and_no_weight(candidate: Candidate) -> None:
    used = np.ones(402, dtype=bool)
    used[[0, 401]] = False
    result = candidate.to_result(Reason.CONVERGED, 'message', np.flatnonzero(used), 402)
    assert (result.received, result.used, result.inliers) == (402, 400, candidate.inliers)
    assert result.residuals_m is not None and result.weights is not None
    assert np.isnan(result.residuals_m[~used]).all()
    assert np.isfinite(result.residuals_m[used]).all()
    assert (result.weights[~used] == 0.0).all()
    np.testing.assert_array_equal(result.weights[used], candidate.solution.weights)


def test_the_predicted_tre_is_given_at_targets_and_over_the_bone(candidate: Candidate) -> None:
    assert candidate.confidence is not None
    tip = candidate.confidence.predicted_tre(np.array([[0.0, 0.0, 0.06]]))
    tre = candidate.confidence.predicted_tre(bone_field().surface_points.astype(np.float64))
    assert candidate.predicted_tre_m == {'tip': tip[0], 'rms': rigid.rms(tre), 'max': tre.max()}


def test_without_confidence_there_is_no_accuracy(candidate: Candidate) -> None:
    unconstrained = assess_candidate(candidate.selected, None, POINTS, bone_field(), CONFIG)
    result = unconstrained.to_result(Reason.UNDER_CONSTRAINED, 'message', np.arange(400), 400)
    assert result.predicted_tre_m == {} and result.weakest_direction is None
    assert result.sigma_m is None and result.inliers == candidate.inliers
