# SPDX-License-Identifier: Apache-2.0
"""The HTML report: its contents, and that it needs no other file."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_text import text_of
from smooth_bone import LANDMARKS, T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration import __version__
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import (
    ConsideredPoses,
    InputError,
    NextTouch,
    Reason,
    RegistrationResult,
)
from gsdf_registration.common.rigid import Array, quaternion_from_rotation, transform
from gsdf_registration.common.samples import untimed
from gsdf_registration.field import Field
from gsdf_registration.registration.pipeline import register
from gsdf_registration.visualization import ReportContent, colours, write_report

OUTLIERS = 20
ABOUT = {'model SHA-256': 'c0ffee' * 10, 'points': '<b>points</b>.csv'}
LARGEST = 3_000_000     # bytes of a report


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


def written(folder: Path, result: RegistrationResult, field: Field | None, points: Array,
            **more: Any) -> str:
    """Return the page of a report."""
    content = ReportContent('a bone & a probe', result, more.pop('config', Config()), field,
                            untimed(points), timed=False, about=ABOUT, **more)
    write_report(folder / 'page.html', content)
    return (folder / 'page.html').read_text(encoding='utf-8')


@pytest.fixture(scope='module')
def page(result: RegistrationResult, field: Field, points: Array,
         tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp('report'), result, field, points, case='case 7',
                   config=Config().replaced({'model.path': 'femur_left.stl'}))


def scene_of(page: str) -> dict[str, Any]:
    """Return what the 3-D view draws."""
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', page)
    assert found is not None
    scene: dict[str, Any] = json.loads(found[1])
    return scene


def rows_of(text: str, kind: type = np.float32) -> Array:
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, 3)


def test_the_page_refers_to_no_other_file(page: str) -> None:
    assert len(page.encode()) < LARGEST
    assert 'http:' not in page and 'https:' not in page
    tags = re.findall(r'<(?:script|link|img|iframe)\b[^>]*>', page)
    assert [tag for tag in tags
            if re.search(r'\b(?:src|href)\s*=\s*"(?!data:image/webp)', tag)] == []


def test_no_value_is_missing_or_not_a_number(page: str) -> None:
    assert re.search(r'\bnan\b|\bnull\b|\bNone\b|Infinity', text_of(page), re.IGNORECASE) is None


def test_the_verdict_and_what_identifies_it_come_first(page: str) -> None:
    text = text_of(page).partition('Registered')[2]
    for words in ('case case 7', 'model femur_left.stl', 'side left', 'zone accurate to 2.0 mm',
                  'grade A', 'error around the touched area (95 %)', 'of 2 mm', 'touched area',
                  '3-D view'):
        assert words in text
        text = text.partition(words)[2]


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
    for number in (result.received, result.inliers):
        assert f' {number} ' in text
    assert result.weakest_direction.sentence in text and __version__ in text
    assert f'{result.timing_s["total"]:.2f} s' in text and ABOUT['model SHA-256'] in text


def test_the_residual_is_never_called_accuracy(page: str) -> None:
    text = text_of(page)
    assert 'It is NOT the accuracy' in text and 'Fit, NOT the accuracy' in text
    assert 'how well the points fit, NOT how accurate' in text


def test_titles_and_values_are_escaped(page: str) -> None:
    assert '<h1>a bone &amp; a probe</h1>' in page
    assert '&lt;b&gt;points&lt;/b&gt;.csv' in page


def test_the_pictures_are_in_the_page(page: str) -> None:
    assert re.findall(r'<figcaption>(.*?)</figcaption>', page) == [
        'touched area', 'whole bone, same direction', 'opposite side']
    pictures = re.findall(r'data:image/webp;base64,([^"]+)', page)
    assert all(base64.b64decode(each)[8:12] == b'WEBP' for each in pictures) and len(pictures) == 3


def test_points_on_the_bone_are_coloured_by_residual_on_the_fixed_scale(
        page: str, result: RegistrationResult, field: Field) -> None:
    scene = scene_of(page)
    cloud, = scene['sets']
    places, shade = rows_of(cloud['points']), rows_of(cloud['colours'], np.uint8)
    assert result.residuals_m is not None and result.weights is not None
    assert len(places) == len(result.residuals_m)
    distance, _ = field.sample(places / 1e3)
    on_bone = result.weights > 0.5
    expected = 255 * colours.residual_colours(distance, result.weights, Config().limits)
    assert np.abs(shade - expected).max() < 3
    assert (shade[~on_bone] == np.round(255 * colours.rgb(colours.UNUSED))).all()
    bone = rows_of(scene['bone']['vertices'])
    assert 1e3 * field.bounds == pytest.approx(np.array([bone.min(axis=0), bone.max(axis=0)]),
                                               abs=1.0)
    assert scene['letters'] == ['LPS', 'RAI'] and len(scene['focus']['centre']) == 3


def test_the_border_of_the_zone_is_drawn(tmp_path: Path, result: RegistrationResult, field: Field,
                                         points: Array) -> None:
    strict = Config().replaced({'limits.max_error': 3e-4})
    border = rows_of(scene_of(written(tmp_path, result, field, points, config=strict))[
        'bone']['border'])
    assert len(border) > 10
    assert np.abs(field.sample(border / 1e3)[0]).max() < 1e-3


def test_an_ambiguous_refusal_draws_the_rivals_and_where_to_touch(
        tmp_path: Path, field: Field, points: Array, result: RegistrationResult) -> None:
    assert result.T_tracker_bone is not None
    rival = result.T_tracker_bone @ np.diag([-1.0, -1.0, 1.0, 1.0])
    top = field.surface_points[0].astype(np.float64)
    touch = NextTouch(top, field.surface_normals[0].astype(np.float64))
    refusal = RegistrationResult(
        Reason.AMBIGUOUS, 'two poses fit; touch the other side', received=400,
        residuals_m=result.residuals_m, weights=result.weights,
        considered=ConsideredPoses(result.T_tracker_bone, result.covariance, (rival,), (touch,)))
    page = written(tmp_path, refusal, field, points)
    text, scene = text_of(page), scene_of(page)
    assert 'Refused: ambiguous two poses fit; touch the other side 1: touch here' in text
    assert 'There is no pose' in text and 'must not be used' in text and 'quaternion' not in text
    assert 'zone' not in text.partition('3-D view')[0]      # that of a wrong pose means nothing
    assert 'pose 2 fits about as well' in text
    one, two = scene['sets']
    assert (one['name'], two['name']) == ('pose 1', 'pose 2')
    turned = rows_of(one['points']) * [-1.0, -1.0, 1.0]
    assert rows_of(two['points']) == pytest.approx(turned, abs=0.01)
    assert [each for each in scene['labels'] if each['kind'] == 'next'] == [
        {'text': '1', 'at': pytest.approx(1e3 * top, abs=0.01), 'kind': 'next'}]


@pytest.mark.parametrize('with_field', [True, False])
def test_a_refusal_without_a_candidate_shows_only_the_points(
        tmp_path: Path, field: Field, points: Array, with_field: bool) -> None:
    refusal = RegistrationResult.refused(Reason.TOO_FEW_POINTS, 'too few points', received=400)
    page = written(tmp_path, refusal, field if with_field else None, points)
    assert 'Refused: too_few_points too few points' in text_of(page) and '<figure>' not in page
    scene = scene_of(page)
    assert scene['bone'] is None
    assert rows_of(scene['sets'][0]['points']) / 1e3 == pytest.approx(points, abs=1e-5)


@pytest.mark.parametrize('points', [np.zeros((0, 3)), np.full((5, 3), np.nan)])
def test_a_refusal_without_usable_points(tmp_path: Path, field: Field, points: Array) -> None:
    refusal = RegistrationResult.refused(Reason.TOO_FEW_POINTS, '0 points are too few')
    assert 'NaN' not in written(tmp_path, refusal, field, points)


def test_many_points_are_downsampled(tmp_path: Path) -> None:
    many = np.random.default_rng(0).normal(size=(50_001, 3))
    refusal = RegistrationResult.refused(Reason.TOO_FEW_INLIERS, 'no')
    page = written(tmp_path, refusal, None, many)
    assert 10_000 < len(rows_of(scene_of(page)['sets'][0]['points'])) <= 20_000
    assert len(page.encode()) < LARGEST


def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path, result: RegistrationResult,
                                                field: Field, points: Array) -> None:
    with pytest.raises(InputError, match='nowhere'):
        written(tmp_path / 'nowhere', result, field, points)
