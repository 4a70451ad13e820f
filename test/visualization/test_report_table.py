# SPDX-License-Identifier: Apache-2.0
"""The table of the report."""

from __future__ import annotations

import numpy as np
from smooth_bone import T_TRACKER_BONE, bone_field

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import LandmarkFit, Reason, RegistrationResult
from gsdf_registration.common.rigid import transform
from gsdf_registration.common.samples import without_tools
from gsdf_registration.visualization.report_content import ReportContent, VerificationPoint
from gsdf_registration.visualization.report_table import changed_parameters, counts, sections

TWO_STROKES = without_tools(np.zeros((4, 3)), np.arange(4.0), np.array([1, 1, 2, 2], np.int32),
                            np.zeros(4, np.int32))


def content_of(result: RegistrationResult, **more: object) -> ReportContent:
    return ReportContent('t', result, Config(), bone_field(), TWO_STROKES,
                         **more)  # type: ignore[arg-type]


def test_counts_add_up_to_the_samples_received() -> None:
    result = RegistrationResult(Reason.CONVERGED, 'found', received=632, used=598, inliers=597,
                                left_out={'isolated': 21, 'repeated': 0}, rejected={'too_fast': 13})
    rows = counts(content_of(result))
    assert rows == [('on the bone', '597'), ('off the bone (outliers)', '1'), ('isolated', '21'),
                    ('rejected: too fast', '13'), ('received', '632')]


def test_samples_that_nothing_explains_are_named() -> None:
    result = RegistrationResult(Reason.CONVERGED, 'found', received=10, used=8, inliers=8)
    assert ('not explained', '2') in counts(content_of(result))


def test_landmarks_are_listed_with_their_residual() -> None:
    fit = LandmarkFit('hip_centre', True, 0.002, 0.0031, 1.2)
    result = RegistrationResult(Reason.CONVERGED, 'found', T_TRACKER_BONE, landmarks=(fit,))
    model = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    touched = transform(T_TRACKER_BONE, model + [[0.0, 0.0, 0.0], [0.0, 0.004, 0.0]])
    landmarks = Landmarks.of(model, touched, [0.002, 0.0], ['hip_centre', 'knee'])
    rows = dict(sections(content_of(result, landmarks=landmarks))['Landmarks'])
    assert rows['hip_centre'].startswith('3.1 mm from its place')
    assert rows['hip_centre'].endswith('is 2.00 mm')
    assert rows['knee'] == '4.00 mm from its place; only an initial guess'
    assert 'Landmarks' not in sections(content_of(RegistrationResult(Reason.CONVERGED, 'found')))


def test_verification_points_are_compared_with_the_limit() -> None:
    points = [VerificationPoint('checkpoint 1', np.zeros(3), -0.001, 9.0),
              VerificationPoint('checkpoint 2', np.zeros(3), 0.0031, 9.0, 0.0005)]
    result = RegistrationResult(Reason.CONVERGED, 'found', T_TRACKER_BONE)
    rows = dict(sections(content_of(result, verifications=points))[
        'Verification points, not used in the fit'])
    assert rows['checkpoint 1'] == '-1.00 mm from the surface, within 2.00 mm'
    assert rows['checkpoint 2'].startswith('+3.10 mm from the surface, BEYOND 2.00 mm; moved 0.50')


def test_strokes_are_listed_with_their_residual() -> None:
    result = RegistrationResult(Reason.CONVERGED, 'found', T_TRACKER_BONE,
                                residuals_m=np.array([1e-3, -1e-3, 2e-3, np.nan]),
                                weights=np.array([1.0, 1.0, 1.0, 0.0]))
    positions = np.arange(12.0).reshape(4, 3)
    points = TWO_STROKES._replace(positions=positions)
    content = ReportContent('t', result, Config(), bone_field(), points)
    assert sections(content)['Strokes'] == [
        ('stroke 1', '2 points, 2 on the bone, 1.00 mm RMS'),
        ('stroke 2', '2 points, 1 on the bone, 2.00 mm RMS')]


def test_only_parameters_that_differ_are_listed() -> None:
    assert changed_parameters(Config()) == []
    assert changed_parameters(Config().replaced({
        'limits.max_error': 0.001, 'model.path': 'a.stl', 'targets.names': ['a'],
        'targets.positions': [0.1, 0.0, 1 / 3]})) == [
            ('limits.max_error', '0.001'), ('targets.names', 'a'),
            ('targets.positions', '0.1, 0, 0.333333')]
