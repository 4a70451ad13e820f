# SPDX-License-Identifier: Apache-2.0
"""The table of the report."""

from __future__ import annotations

from gsdf_registration.common.result import LandmarkFit, Reason, RegistrationResult
from gsdf_registration.visualization.report_table import sections


def test_landmarks_are_listed_with_their_standard_deviation_if_there_are_any() -> None:
    heading = 'Landmarks as measurements'
    result = RegistrationResult(Reason.CONVERGED, 'found', landmarks=(
        LandmarkFit('hip_centre', True, 0.002, 0.0031, 1.2),))
    (name, value), = sections(result, {})[heading]
    assert name == 'hip_centre'
    assert value.startswith('3.1 mm from its place') and value.endswith('is 2.00 mm')
    assert heading not in sections(RegistrationResult(Reason.CONVERGED, 'found'), {})
