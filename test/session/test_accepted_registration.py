# SPDX-License-Identifier: Apache-2.0
"""The accepted registration and the points of the collection as they change."""

from __future__ import annotations

import numpy as np
import pytest
from session_fixtures import T_TRACKER_BONE

from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.samples import without_tools
from gsdf_registration.session.accepted_registration import AcceptedRegistration

SERIALS = np.array([3, 4, 7, 9])


@pytest.fixture
def accepted() -> AcceptedRegistration:
    points = without_tools(np.zeros((4, 3)), np.arange(4.0), np.array([1, 1, 2, 2], np.int32),
                           np.array([0, 0, 1, 1], np.int32))
    result = RegistrationResult(
        Reason.CONVERGED, 'found', T_TRACKER_BONE,
        residuals_m=np.array([1e-4, np.nan, 2e-4, 3e-4]), weights=np.array([1.0, 0.0, 0.5, 1.0]))
    return AcceptedRegistration(result, points, SERIALS, 'cam')


def test_is_outdated_when_one_of_its_points_is_dropped(accepted: AcceptedRegistration) -> None:
    assert not accepted.outdated(np.array([3, 4, 7, 9, 10]))
    assert accepted.outdated(np.array([3, 4, 9, 10]))


def test_fit_is_unknown_for_points_that_were_not_registered(
        accepted: AcceptedRegistration) -> None:
    residuals, weights = accepted.fit(np.array([1, 4, 7, 10]))
    np.testing.assert_array_equal(residuals, [np.nan, np.nan, 2e-4, np.nan])
    np.testing.assert_array_equal(weights, [np.nan, 0.0, 0.5, np.nan])     # 0: an outlier


def test_knows_whether_it_used_the_last_points_of_a_source(accepted: AcceptedRegistration) -> None:
    assert accepted.uses(1, since=3.0) and not accepted.uses(1, since=3.5)
    assert not accepted.uses(0, since=2.0)
