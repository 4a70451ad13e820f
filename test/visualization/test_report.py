# SPDX-License-Identifier: Apache-2.0
"""The HTML report: its contents, and that it needs no other file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from smooth_bone import LANDMARKS, T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration import __version__
from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.rigid import Array, quaternion_from_rotation, transform
from gsdf_registration.field import Field
from gsdf_registration.registration.pipeline import register
from gsdf_registration.visualization import report_scene, write_report

OUTLIERS = 20
ABOUT = {'model SHA-256': 'c0ffee' * 10, 'points': '<b>points</b>.csv'}


@pytest.fixture(scope='module')
def field() -> Field:
    return bone_field()


@pytest.fixture(scope='module')
def points() -> Array:
    """Return points in the tracker frame, some of them far off the bone."""
    on_bone = touched_points(400, sigma=0.0002)
    on_bone[:OUTLIERS] *= 1.3
    return transform(T_TRACKER_BONE, on_bone)


@pytest.fixture(scope='module')
def result(points: Array, field: Field) -> RegistrationResult:
    result = register(points, field, landmarks=(LANDMARKS, transform(T_TRACKER_BONE, LANDMARKS)))
    assert result.success, result.message
    return result


@pytest.fixture(scope='module')
def page(result: RegistrationResult, field: Field, points: Array,
         tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp('report') / 'page.html'
    write_report(file, result, field, points, title='a bone & a probe', about=ABOUT)
    return file.read_text(encoding='utf-8')


def without_plotly(page: str) -> str:
    """Return a page without the script of plotly, the longest one."""
    return page.replace(max(re.findall(r'<script.*?</script>', page, re.DOTALL), key=len), '')


def text_of(page: str) -> str:
    """Return the text of a page without its scripts."""
    page = re.sub(r'<(script|style).*?</\1>', '', page, flags=re.DOTALL)
    return re.sub(r'\s+', ' ', re.sub(r'<[^>]+>', ' ', page))


def test_the_page_refers_to_no_other_file(page: str) -> None:
    assert len(page.encode()) < 6_000_000
    assert page.count('plotly.js v') == 1
    tags = re.findall(r'<(?:script|link|img|iframe)\b[^>]*>', page)
    assert [tag for tag in tags if re.search(r'\b(?:src|href)\s*=', tag)] == []
    assert 'http' not in without_plotly(page)


def test_no_value_is_missing_or_not_a_number(page: str) -> None:
    assert re.search(r'\bnan\b|\bnull\b|\bNone\b|Infinity', text_of(page), re.IGNORECASE) is None
    assert re.search(r'\bNaN\b|Infinity', without_plotly(page)) is None


def test_a_pose_is_reported_with_its_numbers(page: str, result: RegistrationResult) -> None:
    text = text_of(page)
    T = result.T_tracker_bone
    assert T is not None and result.sigma_m is not None and result.weakest_direction is not None
    assert result.residual_rms_m is not None
    assert 'Registered' in text and 'Refused' not in text and result.message in text
    assert ', '.join(f'{1e3 * value:.2f}' for value in T[:3, 3]) + ' mm' in text
    assert ', '.join(f'{q:.6f}' for q in quaternion_from_rotation(T[:3, :3])) in text
    for metres in (result.predicted_tre_m['rms'], result.predicted_tre_m['max'], result.sigma_m,
                   result.residual_rms_m):
        assert f' {1e3 * metres:.2f} mm' in text
    for number in (result.received, result.used, result.inliers):
        assert f' {number} ' in text
    assert result.weakest_direction.sentence in text and __version__ in text
    assert f'{result.timing_s["total"]:.2f} s' in text and ABOUT['model SHA-256'] in text


def test_the_residual_is_never_called_accuracy(page: str) -> None:
    text = text_of(page)
    assert 'It is NOT the accuracy' in text and 'Fit, NOT the accuracy' in text
    assert 'how well they fit, NOT how accurate' in text


def test_titles_and_values_are_escaped(page: str) -> None:
    assert '<h1>a bone &amp; a probe</h1>' in page
    assert '&lt;b&gt;points&lt;/b&gt;.csv' in page and '<b>points' not in page


def test_points_are_drawn_at_their_places_on_the_bone(result: RegistrationResult, field: Field,
                                            points: Array) -> None:
    bone, inliers, others, axis = report_scene.bone_scene(result, field, points).data
    assert len(inliers.x) == result.inliers and len(others.x) == len(points) - result.inliers
    assert others.marker.symbol == 'circle-open'
    shown = np.stack([inliers.x, inliers.y, inliers.z], axis=1) / 1e3
    distance, _ = field.sample(shown)
    assert distance * 1e3 == pytest.approx(inliers.marker.color, abs=0.02)
    assert np.abs(distance).max() < 0.0015
    low, high = 1e3 * field.bounds
    assert low == pytest.approx([min(bone.x), min(bone.y), min(bone.z)], abs=1.0)
    assert high == pytest.approx([max(bone.x), max(bone.y), max(bone.z)], abs=1.0)


@pytest.mark.parametrize('with_field', [True, False])
def test_a_refusal_shows_the_reason_and_only_the_points(tmp_path: Path, field: Field, points: Array,
                                                     with_field: bool) -> None:
    message = 'another pose fits; touch the other side'
    refusal = RegistrationResult(Reason.AMBIGUOUS, message, received=400, runner_up_ratio=1.02)
    file = tmp_path / 'refused.html'
    write_report(file, refusal, field if with_field else None, points, title='t', about={})
    text = text_of(file.read_text())
    assert f'Refused: ambiguous {message}' in text
    assert 'There is no pose' in text and 'quaternion' not in text and '1.02' in text
    assert 'Of the rejected candidate: Expected accuracy' in text
    cloud, = report_scene.tracker_scene(points).data
    assert np.stack([cloud.x, cloud.y, cloud.z], axis=1) / 1e3 == pytest.approx(points, abs=1e-5)


@pytest.mark.parametrize('points', [np.zeros((0, 3)), np.full((5, 3), np.nan)])
def test_a_refusal_without_usable_points(tmp_path: Path, field: Field, points: Array) -> None:
    refusal = RegistrationResult.refused(Reason.TOO_FEW_POINTS, '0 points are too few')
    write_report(tmp_path / 'a.html', refusal, field, points, title='t', about={})
    assert 'NaN' not in without_plotly((tmp_path / 'a.html').read_text())


def test_many_points_are_downsampled() -> None:
    many = np.random.default_rng(0).normal(size=(50_001, 3))
    cloud, = report_scene.tracker_scene(many).data
    assert 10_000 < len(cloud.x) <= report_scene.MAX_POINTS


def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path, result: RegistrationResult,
                                                field: Field, points: Array) -> None:
    with pytest.raises(InputError, match='nowhere'):
        write_report(tmp_path / 'nowhere/a.html', result, field, points, title='t', about={})
